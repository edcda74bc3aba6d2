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

from written import PRUNE_AT, PRUNE_EVERY, Open, Written, WrittenJournal, WrittenSpool

from camtopod.config.settings import KeepSettings

FILES: dict[str, Open] = {
    "journal": lambda directory: WrittenJournal(directory, KeepSettings()),
    "spool": lambda directory: WrittenSpool(directory, 1_000_000, 1_000_000),
}
"""Files that forget nothing."""
NUMBER = struct.Struct("<Q")
"""Format of a step's number on the pipe."""
SECONDS_MAX = 0.03
"""Longest time that a writer runs, seconds."""
KILLS_A_FILE = 20
STEPS_MAX = 100_000
"""Of a writer: the next begins so far behind it."""


def write(one: Written, number: int, pipe: int, early: bool) -> None:
    """Write steps until killed; the pipe gets each number after (``early``: before) its step."""
    while True:
        if early:
            os.write(pipe, NUMBER.pack(number))
        one.step(number)
        if not early:
            os.write(pipe, NUMBER.pack(number))
        number += 1


def durable_steps(make: Open, directory: Path, start: int, early: bool, delay: float) -> set[int]:
    """Run and kill a writer; return the steps that it reported durable.

    delay: seconds from its first step to the kill; if negative it is killed as it opens the file.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            write(make(directory), start, writing, early)
        finally:
            os._exit(1)
    os.close(writing)
    said = os.read(reading, NUMBER.size) if delay >= 0 else b""
    time.sleep(abs(delay))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while more := os.read(reading, 65536):
        said += more
    os.close(reading)
    numbers = {int(number) for (number,) in NUMBER.iter_unpack(said)}
    return {number for number in numbers if number % PRUNE_EVERY != PRUNE_AT}


def main() -> None:
    """Kill writers and check the file after each."""
    name, folder, kills = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
    chance = random.Random(1)
    durable, lost = 0, 0
    for kill in range(kills):
        directory = folder / str(kill // KILLS_A_FILE)
        if not directory.exists():
            directory.mkdir()
            FILES[name](directory).close()  # creation of the file is tested elsewhere
        delay = chance.uniform(-0.2, 0.8) * SECONDS_MAX / 0.8
        said = durable_steps(
            FILES[name], directory, 1 + kill * STEPS_MAX, "early" in sys.argv[4:], delay
        )
        one = FILES[name](directory)
        assert not one.damaged
        durable += len(said)
        lost += len(said - one.whole_steps())
        one.close()
    print(json.dumps({"kills": kills, "durable": durable, "lost": lost}))


main()
