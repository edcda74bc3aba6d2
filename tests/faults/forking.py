"""Fork a writer of a journal or a spool, kill it, check what it left, and repeat.

The program has a single thread. Arguments: journal or spool, directory, number of kills, and
"early" for a writer that reports a step before it is durable. Prints, as JSON, how many steps were
reported durable and how many of them were lost.
"""

from __future__ import annotations

import json
import os
import random
import signal
import struct
import sys
import time
from pathlib import Path

from written import FILES, Written, WrittenSpool


class LongSpool(WrittenSpool):
    """A spool that forgets nothing."""

    events_max, kept_max = 1_000_000, 1_000_000


FILES["spool"] = LongSpool
NUMBER = struct.Struct("<Q")
"""Format of a step's number on the pipe."""
SECONDS_MAX = 0.03
"""Longest time that a writer runs, seconds."""


def write(one: Written, start: int, pipe: int, early: bool) -> None:
    """Write steps until killed; each number goes to the pipe after (or, if ``early``, before) its
    step.
    """
    number = start
    while True:
        if early:
            os.write(pipe, NUMBER.pack(number))
        one.step(number)
        if not early:
            os.write(pipe, NUMBER.pack(number))
        number += 1


def killed_writer(
    name: str, directory: Path, start: int, early: bool, chance: random.Random
) -> int:
    """Run and kill a writer; return the last step that it reported durable, or ``start - 1``.

    Most are killed some time after their first step, some while they open the file.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            write(FILES[name](directory), start, writing, early)
        finally:
            os._exit(1)
    os.close(writing)
    said = os.read(reading, NUMBER.size) if chance.random() < 0.8 else b""
    time.sleep(chance.uniform(0, SECONDS_MAX))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while more := os.read(reading, 65536):
        said += more
    os.close(reading)
    whole = len(said) // NUMBER.size
    return int(NUMBER.unpack_from(said, (whole - 1) * NUMBER.size)[0]) if whole else start - 1


def main() -> None:
    """Kill writers and check the file after each."""
    name, directory = sys.argv[1], Path(sys.argv[2])
    kills, early = int(sys.argv[3]), "early" in sys.argv[4:]
    chance = random.Random(1)
    FILES[name](directory).close()  # creation of the file is tested elsewhere
    durable = lost = done = 0
    for _ in range(kills):
        said = killed_writer(name, directory, done + 1, early, chance)
        one = FILES[name](directory)
        assert not one.damaged
        there = one.last()
        assert there <= said + 2, f"step {there} is stored"  # one that prunes leaves no trace
        durable += said - done
        lost += len(one.missing(done + 1, said + 1))
        one.close()
        done = max(there, said)
    print(json.dumps({"kills": kills, "durable": durable, "lost": lost}))


main()
