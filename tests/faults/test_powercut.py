"""Power cuts and kills between any two operations on the disk: what was durable survives."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import NamedTuple

import pytest
from powercut import Image, Record, images, put
from sizes import size
from vfs import Vfs
from written import FILES, Open, State, WrittenJournal

from camtopod.serve.storage.sqlite_file import StateError

GOES_ON_EVERY = 20
"""Of the images, one in so many is also written on."""


class Outcome(NamedTuple):
    """Number of images that were looked at, and the faults of those that are wrong."""

    images: int
    lost: list[str]


def recorded(make: Open, steps: int, directory: Path, watch: Vfs) -> tuple[Record, list[State]]:
    """Write ``steps`` steps; return the operations, and the content after opening and each step."""
    record, states = Record(), []
    directory.mkdir()
    with watch.watching(record):
        one = make(directory)
        states.append(one.state())
        record.mark("done", 0)
        for number in range(1, steps + 1):
            record.mark("begun", number)
            one.step(number)
            record.mark("done", number)
            states.append(one.state())
        one.close()
    return record, states


def fault_of(image: Image, make: Open, states: list[State], directory: Path, goes_on: bool) -> str:
    """Return the fault found when ``image`` is opened; "" if there is none."""
    put(image.content, directory)
    try:
        one = make(directory)
    except StateError as error:
        return f"does not open: {error}"
    try:
        found = one.state()
        if one.damaged:
            return "was set aside"
        if found not in states[max(image.done, 0) : max(image.begun, 0) + 1]:
            known = found in states
            return f"is as after step {states.index(found)}" if known else "is as never before"
        if goes_on:
            one.step(len(states))
            after = one.state()
            one.close()
            one = make(directory)
            return "" if one.state() == after != found else "does not go on"
        return ""
    finally:
        one.close()


def run(make: Open, steps: int, each: int, base: Path, watch: Vfs, every: int = 1) -> Outcome:
    """Check every ``every``-th image of a file that is made and written in ``steps`` steps."""
    record, states = recorded(make, steps, base / "real", watch)
    directory = base / "image"
    directory.mkdir()
    count, lost = 0, []
    for image in itertools.islice(images(record.ops, each), 0, None, every):
        fault = fault_of(image, make, states, directory, count % GOES_ON_EVERY == 0)
        if fault:
            lost.append(f"after operation {image.after_op}, {image.done} steps done: {fault}")
        count += 1
    return Outcome(count, lost)


@pytest.mark.parametrize("name", FILES)
def test_no_power_cut_loses_what_was_durable(name: str, quick_path: Path, disk_watch: Vfs) -> None:
    outcome = run(FILES[name], 42, 1, quick_path, disk_watch, every=4)

    assert outcome.lost == []
    assert outcome.images > 100


class NormalJournal(WrittenJournal):
    """A journal that does not sync the log at each commit."""

    def __init__(self, directory: Path) -> None:
        super().__init__(directory)
        self.journal._db.execute("PRAGMA synchronous=NORMAL")


def test_the_harness_sees_that_normal_is_not_enough(quick_path: Path, disk_watch: Vfs) -> None:
    outcome = run(NormalJournal, 20, 1, quick_path, disk_watch, every=5)

    assert len(outcome.lost) > 5
    assert any("is as after step" in problem for problem in outcome.lost)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", FILES)
def test_campaign_of_power_cuts(name: str, quick_path: Path, disk_watch: Vfs) -> None:
    steps = size("POWERCUT_STEPS", 200)
    outcome = run(FILES[name], steps, size("POWERCUT_EACH", 4), quick_path, disk_watch)

    print(f"{name}: {outcome.images} images, {len(outcome.lost)} lost")
    assert outcome.lost == []
    assert outcome.images > 20 * steps
