"""The disk is full or fails, at any single operation, and under the daemon.

Nothing is acknowledged that is not stored, and writing continues by itself when there is room.
"""

from __future__ import annotations

import contextlib
import itertools
import random
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from grabber import Grabber, stored
from powercut import Disk, Record, put
from serving import wait_for
from sizes import size
from vfs import EIO, FULL, Fault, Op, Vfs
from written import FILES, Open, State, Written, WrittenJournal

from camtopod.serve.storage.journal import Journal

Kind = Literal["full", "short", "eio"]
KINDS: tuple[Kind, ...] = ("full", "short", "eio")
ATTEMPTS_MAX = 50
STEPS_AFTER = 8
"""Written after a fault that came once, before what is there is looked at."""


class Spoiler:
    """Records operations in one directory, and spoils ``count`` of them from number
    ``first`` on.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self.record = Record()
        self.kind: Kind = "eio"
        self.first = self.until = sys.maxsize
        self.seen = 0
        self.spoiled = 0

    def arm(self, kind: Kind, first: int, count: int = 1) -> None:
        self.kind, self.first, self.until = kind, first, first + count
        self.seen = self.spoiled = 0

    def disarm(self) -> None:
        self.first = self.until = sys.maxsize

    def __call__(self, op: Op) -> Fault | None:
        if Path(op.path).parent != self._directory:
            return None
        if self.kind == "eio" or op.kind in ("create", "write", "shm"):
            self.seen += 1
            if self.first <= self.seen < self.until:
                self.spoiled += 1
                return self._spoil(op)
        self.record(op)
        return None

    def _spoil(self, op: Op) -> Fault:
        if op.kind == "sync":
            self.record(op._replace(kind="sync failed"))
        if op.kind == "write" and self.kind == "short":
            self.record(op._replace(data=op.data[: len(op.data) // 2]))
            return Fault(FULL, short=True)
        return Fault(FULL if op.kind == "write" and self.kind == "full" else EIO[op.kind])


def reference(make: Open, steps: int, directory: Path) -> list[State]:
    """Return the content after opening and after each step without faults."""
    directory.mkdir()
    one = make(directory)
    states = [one.state()]
    for number in range(1, steps + 1):
        one.step(number)
        states.append(one.state())
    one.close()
    return states


def attempt(one: Written, number: int) -> int:
    """Repeat a step until it succeeds; return the number of refusals."""
    for refused in range(ATTEMPTS_MAX):
        try:
            one.step(number)
        except sqlite3.Error:
            continue
        return refused
    raise AssertionError(f"step {number} was refused though the disk was in order again")


def after_power_cut(record: Record, make: Open, directory: Path) -> State:
    """Return the content after a power cut in which only certain data survives."""
    disk = Disk()
    for op in record.ops:
        disk.apply(op)
    directory.mkdir(exist_ok=True)
    put(disk.image("synced", random.Random(0)), directory)
    with contextlib.closing(make(directory)) as one:
        assert not one.damaged
        return one.state()


def each_write_fails_once(name: str, kind: Kind, steps: int, base: Path, disk_watch: Vfs) -> None:
    """Try each step of a file with its first operation failing, then its second, and so on."""
    make = FILES[name]
    states = reference(make, steps, base / "reference")
    directory = base / "real"
    directory.mkdir()
    spoiler = Spoiler(directory)
    refused = 0
    with disk_watch.watching(spoiler), contextlib.closing(make(directory)) as one:
        for number in range(1, steps + 1):
            for first in itertools.count(1):
                spoiler.arm(kind, first)
                try:
                    one.step(number)
                except sqlite3.Error:
                    assert spoiler.spoiled, "it failed and nothing was spoiled"
                    refused += 1
                    continue
                break
            spoiler.disarm()
            if number % 20 == 0:
                assert after_power_cut(spoiler.record, make, base / "image") == states[number]
        assert one.state() == states[-1]

    with contextlib.closing(make(directory)) as one:
        assert not one.damaged
        assert one.state() == states[-1]
    print(f"{name} {kind}: {refused} refusals in {steps} steps")
    assert refused > 3 * steps
    for folder in base.iterdir():
        shutil.rmtree(folder)


@pytest.mark.parametrize("name", FILES)
def test_each_write_of_each_commit_fails_once(name: str, quick_path: Path, disk_watch: Vfs) -> None:
    for kind, steps in zip(KINDS, (20, 5, 5), strict=True):
        each_write_fails_once(name, kind, steps, quick_path, disk_watch)


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", FILES)
def test_campaign_of_each_write_of_each_commit(
    name: str, quick_path: Path, disk_watch: Vfs
) -> None:
    for kind in KINDS:
        each_write_fails_once(name, kind, size("FULL_STEPS", 200), quick_path, disk_watch)


def fails_at(
    make: Open, kind: Kind, first: int, count: int, states: list[State], base: Path, watch: Vfs
) -> tuple[int, bool]:
    """Run with ``count`` operations failing from number ``first`` on.

    Returns the refused attempts and whether any operation failed.
    """
    directory = base / f"{kind} {first}"
    directory.mkdir()
    spoiler = Spoiler(directory)
    refused = 0
    with watch.watching(spoiler), contextlib.closing(make(directory)) as one:
        spoiler.arm(kind, first, count)
        left = STEPS_AFTER
        for number in range(1, len(states)):
            refused += attempt(one, number)
            left -= spoiler.spoiled >= count
            if left == 0:
                break
        spoiler.disarm()
        assert one.state() == states[number]
        assert after_power_cut(spoiler.record, make, base / "image") == states[number]
    shutil.rmtree(directory)
    return refused, spoiler.spoiled > 0


def operations_fail(name: str, steps: int, every: int, base: Path, watch: Vfs) -> None:
    """Let every ``every``-th operation of so many steps fail, or those that follow, too."""
    states = reference(FILES[name], steps, base / "reference")
    points = refused = 0
    for number, first in enumerate(itertools.count(1, every)):
        kind = KINDS[number % len(KINDS)]
        count = (1, 12)[number % 2]
        more, failed = fails_at(FILES[name], kind, first, count, states, base, watch)
        if not failed:
            break
        points += 1
        refused += more
    print(f"{name}: {points} operations failed, {refused} commits refused, none lost")
    assert points > steps // every
    assert refused > points // 4


@pytest.mark.parametrize("name", FILES)
def test_any_operation_fails_in_a_file_of_its_own(
    name: str, quick_path: Path, disk_watch: Vfs
) -> None:
    """This covers checkpoints; in the test above, failing commits prevent them."""
    operations_fail(name, 75, 47, quick_path, disk_watch)


@pytest.mark.campaign
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", FILES)
def test_campaign_of_operations_that_fail(name: str, quick_path: Path, disk_watch: Vfs) -> None:
    steps = size("FAILS_STEPS", 300)
    operations_fail(name, steps, size("FAILS_EVERY", 17), quick_path, disk_watch)


class Careless(WrittenJournal):
    """A journal that ignores refusals, and so loses data."""

    def step(self, number: int) -> None:
        with contextlib.suppress(sqlite3.Error):
            super().step(number)


def test_the_harness_sees_a_false_acknowledgement(quick_path: Path, disk_watch: Vfs) -> None:
    states = reference(WrittenJournal, 20, quick_path / "reference")
    with pytest.raises(AssertionError):
        fails_at(Careless, "full", 30, 1, states, quick_path, disk_watch)


# --- a disk that is really full -------------------------------------------------------------------


@pytest.fixture
def small_disk(quick_path: Path) -> Iterator[Path]:
    """Mount a file system of 3 MB; skipped only if the environment says so."""
    disk = quick_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "camtopod-test", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        if size("NO_MOUNT", 0):
            pytest.skip("no small file system: CAMTOPOD_FAULTS_NO_MOUNT is set")
        pytest.fail("cannot mount a small file system: needs root, or CAMTOPOD_FAULTS_NO_MOUNT=1")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


@contextlib.contextmanager
def full(disk: Path) -> Iterator[None]:
    """Fill the rest of the disk while the block runs."""
    with (disk / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
    try:
        yield
    finally:
        (disk / "filler").unlink()


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", FILES)
def test_campaign_on_a_file_system_that_is_full(
    name: str, small_disk: Path, quick_path: Path
) -> None:
    """It is filled at forty different moments, and freed again each time."""
    steps, refused = 400, 0
    states = reference(FILES[name], steps, quick_path / "reference")
    with contextlib.closing(FILES[name](small_disk)) as one:
        for number in range(1, steps + 1):
            if number % 10 == 0:
                refused += refused_while_full(one, number, small_disk)
            else:
                refused += attempt(one, number)
        assert one.state() == states[steps]
    with contextlib.closing(FILES[name](small_disk)) as one:
        assert not one.damaged
        assert one.state() == states[steps]
    print(f"{name}: refused {refused} times in {steps} steps, nothing lost")
    assert refused > 5, "room that was free in the files was enough"


def refused_while_full(one: Written, number: int, disk: Path) -> int:
    """Run a step on a full disk, then with room again; return the number of refusals."""
    with full(disk):
        for refused in range(3):
            try:
                one.step(number)
            except sqlite3.Error:
                continue
            return refused
    return 3 + attempt(one, number)


# --- under the daemon -----------------------------------------------------------------------------


@pytest.fixture
def grabber(small_disk: Path, tmp_path: Path) -> Iterator[Grabber]:
    """Return a grabber beside a daemon whose state is on the small disk."""
    with contextlib.closing(Grabber(tmp_path, small_disk / "state")) as one:
        yield one


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_a_daemon_on_a_full_file_system(small_disk: Path, grabber: Grabber, tmp_path: Path) -> None:
    reason = "cannot write the journal: database or disk is full"
    with grabber.daemon() as daemon:
        grabber.attach()
        grabber.publish(100)
        grabber.await_stored()
        with full(small_disk):

            def degraded() -> bool:
                grabber.publish(100)
                return bool(daemon.status().state == "degraded")

            wait_for(degraded, "it to notice")
            assert daemon.status().reason == reason
            assert daemon.unready() == [reason]
            assert daemon.failing() == [], "starting it again would not help"
            acknowledged = grabber.acknowledged
            grabber.publish(100)
            daemon.stop()
            assert grabber.acknowledged == acknowledged
            shutil.copytree(small_disk / "state", tmp_path / "copy")
            assert acknowledged <= len(stored(tmp_path / "copy")) < grabber.made
            with grabber.daemon() as again:
                wait_for(lambda: again.status().state == "degraded", "it to notice")
                assert grabber.acknowledged < grabber.made
    with grabber.daemon() as daemon:
        grabber.await_stored()
        assert daemon.status().state == "running"
    seqs = [seq for seq, _ in stored(small_disk / "state")]
    assert seqs == list(range(1, grabber.made + 1))
    print(f"{acknowledged} of {grabber.made} events acknowledged before the disk was full")


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_the_harness_sees_what_is_acknowledged_and_not_there(
    small_disk: Path, grabber: Grabber, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The canary: a journal that claims to have stored what it could not."""
    commit = Journal.commit

    def careless(self: Journal, *given: Any, **more: Any) -> None:
        with contextlib.suppress(sqlite3.Error):
            commit(self, *given, **more)

    with grabber.daemon():
        grabber.attach()
        monkeypatch.setattr(Journal, "commit", careless)
        with full(small_disk):
            grabber.publish(2_000)
            grabber.await_stored()
        shutil.copytree(small_disk / "state", tmp_path / "copy")
        assert len(stored(tmp_path / "copy")) < grabber.acknowledged
