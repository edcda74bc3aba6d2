"""A program of one thread that forks a writer of a journal or a spool, kills it, looks at what it
left, and again.

Arguments: journal or spool, directory, number of kills, and "early" for a writer that says so
before it is durable. Says on standard output, as JSON, how many steps the writers had said were
durable and how many of them were lost.
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

from written import Written, WrittenJournal, WrittenSpool


class LongSpool(WrittenSpool):
    """Forgets nothing."""

    events_max, kept_max = 1_000_000, 1_000_000


FILES = {"journal": WrittenJournal, "spool": LongSpool}
NUMBER = struct.Struct("<Q")
SECONDS_MAX = 0.03
"""A writer goes on for at most so long."""


def write(one: Written, start: int, pipe: int, early: bool) -> None:
    """Steps, each followed (or preceded) by its number on the pipe, until killed."""
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
    """The last step that a writer said to be durable before it was killed; ``start - 1`` if none.

    Most are killed a while after their first step, some while they open the file.
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
    """Kill; look; go on."""
    name, directory, kills, early = (
        sys.argv[1],
        Path(sys.argv[2]),
        int(sys.argv[3]),
        "early" in sys.argv[4:],
    )
    chance = random.Random(1)
    FILES[name](directory).close()  # how a file is made is another test's
    durable = lost = done = 0
    for _ in range(kills):
        said = killed_writer(name, directory, done + 1, early, chance)
        one = FILES[name](directory)
        assert not one.damaged
        there = one.last()
        assert there <= said + 2, (
            f"{there} is there, and {said + 1} was begun"
        )  # a step that forgets shows nowhere
        durable += said - done
        lost += len(one.missing(done + 1, said + 1))
        one.close()
        done = max(there, said)
    print(json.dumps({"kills": kills, "durable": durable, "lost": lost}))


main()
