"""The disk is full, slow or fails, at any single operation, and under the daemon.

Nothing is acknowledged that is not stored, and writing continues by itself when there is room.
Predictions wait for no disk.
"""

from __future__ import annotations

import contextlib
import itertools
import shutil
import sqlite3
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import pytest
from grabber import Delays, Grabber, learned_state, publisher_on, stored
from powercut import Disk, Record, put
from serving import WAIT_SECONDS, small_config, wait_for
from sizes import size
from vfs import EIO, FULL, Fault, Op, Vfs
from written import FILES, Open, State, Written, WrittenJournal

from camtopod.serve.bus import dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import SpoolPublisher
from camtopod.serve.storage import StateError

Kind = Literal["full", "short", "eio"]
KINDS: tuple[Kind, ...] = ("full", "short", "eio")
ATTEMPTS_MAX = 50
STEPS_AFTER = 8
"""Written after a fault that came once, before what is there is looked at."""


class Spoiler:
    """Records operations in one directory, and spoils ``count`` of them from number ``first`` on."""

    def __init__(self, directory: Path, kind: Kind) -> None:
        self._directory = directory
        self._kind = kind
        self._spoil_from = self._spoil_until = sys.maxsize
        self._seen = 0
        self.record = Record()
        self.spoiled = 0

    def arm(self, first: int, count: int) -> None:
        self._seen = 0
        self._spoil_from = first
        self._spoil_until = first + count

    def __call__(self, op: Op) -> Fault | None:
        if Path(op.path).parent != self._directory:
            return None
        if self._kind == "eio" or op.kind in ("create", "write", "shm"):
            self._seen += 1
            if self._spoil_from <= self._seen < self._spoil_until:
                self.spoiled += 1
                return self._spoil(op)
        self.record(op)
        return None

    def _spoil(self, op: Op) -> Fault:
        if op.kind == "sync":
            self.record(op._replace(kind="sync failed"))
        if op.kind == "write" and self._kind == "short":
            self.record(op._replace(data=op.data[: len(op.data) // 2]))
            return Fault(FULL, short=True)
        return Fault(FULL if op.kind == "write" and self._kind == "full" else EIO[op.kind])


def states_without_faults(make: Open, steps: int, directory: Path) -> list[State]:
    """Return the content after opening and after each step."""
    directory.mkdir()
    with contextlib.closing(make(directory)) as one:
        states = [one.state()]
        for number in range(1, steps + 1):
            one.step(number)
            states.append(one.state())
    return states


def refusals(one: Written, number: int) -> int:
    """Repeat a step until it succeeds; return how often it was refused."""
    for refused in range(ATTEMPTS_MAX):
        try:
            one.step(number)
        except sqlite3.Error:
            continue
        return refused
    raise AssertionError(f"step {number} was refused though the disk was in order again")


def state_after_power_cut(record: Record, make: Open, directory: Path) -> State:
    """Return the content after a power cut in which only certain data survives."""
    disk = Disk()
    for op in record.ops:
        disk.apply(op)
    directory.mkdir(exist_ok=True)
    put(disk.content(), directory)
    with contextlib.closing(make(directory)) as one:
        assert not one.damaged
        return one.state()


def fails_at(
    make: Open, kind: Kind, first: int, count: int, states: list[State], base: Path, watch: Vfs
) -> tuple[int, bool]:
    """Run with ``count`` operations failing from number ``first`` on.

    Returns the refused attempts and whether any operation failed.
    """
    directory = base / f"{kind} {first}"
    directory.mkdir()
    spoiler = Spoiler(directory, kind)
    refused, left = 0, STEPS_AFTER
    with watch.watching(spoiler), contextlib.closing(make(directory)) as one:
        spoiler.arm(first, count)
        for number in range(1, len(states)):
            refused += refusals(one, number)
            left -= spoiler.spoiled >= count
            if left == 0:
                break
        spoiler.arm(sys.maxsize, 0)
        assert one.state() == states[number]
        assert state_after_power_cut(spoiler.record, make, base / "image") == states[number]
    shutil.rmtree(directory)
    return refused, spoiler.spoiled > 0


def operations_fail(name: str, steps: int, every: int, base: Path, watch: Vfs) -> None:
    """Let every ``every``-th operation of so many steps fail, or those that follow, too."""
    states = states_without_faults(FILES[name], steps, base / "reference")
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
def test_what_fails_is_repeated_and_nothing_is_lost(
    name: str, quick_path: Path, disk_watch: Vfs
) -> None:
    operations_fail(name, 75, 17, quick_path, disk_watch)


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
    states = states_without_faults(WrittenJournal, 20, quick_path / "reference")

    with pytest.raises(AssertionError):
        fails_at(Careless, "full", 30, 1, states, quick_path, disk_watch)


@pytest.mark.parametrize("killed", [False, True])
@pytest.mark.parametrize("name", FILES)
def test_a_start_only_reads(
    name: str, killed: bool, quick_path: Path, disk_watch: Vfs, monkeypatch: pytest.MonkeyPatch
) -> None:
    with contextlib.closing(FILES[name](quick_path)) as one:
        for number in range(1, 4):
            one.step(number)
        before = one.state()
        if killed:
            shutil.copytree(quick_path, quick_path / "copy")
    directory = quick_path / "copy" if killed else quick_path

    def no_room(op: Op) -> Fault | None:
        faults = {"write": FULL, "shm": EIO["shm"]}
        return Fault(faults[op.kind]) if op.kind in faults else None

    # The disk is full: everything is there, and nothing can be added.
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Namespace(free=0))
    with disk_watch.watching(no_room), contextlib.closing(FILES[name](directory)) as one:
        assert one.state() == before
        with pytest.raises(sqlite3.Error):
            one.step(4)

    # It is none that memory can be shared on, as those of a network or of FUSE.
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Namespace(free=10**9))
    kind = "disk I/O error; the file was not modified: the state needs a local disk .* of type \\w+"
    with disk_watch.watching(no_room), pytest.raises(StateError, match=kind):
        FILES[name](directory)
    with contextlib.closing(FILES[name](directory)) as one:
        assert one.state() == before


# --- under the daemon, on a disk that is really full ----------------------------------------------


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
@pytest.mark.timeout(600)
def test_a_daemon_on_a_full_file_system(small_disk: Path, tmp_path: Path) -> None:
    reason = "cannot write the journal: database or disk is full"
    state = small_disk / "state"
    with contextlib.closing(Grabber(tmp_path, state)) as grabber:
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
                shutil.copytree(state, tmp_path / "copy")
                assert acknowledged <= len(stored(tmp_path / "copy")) < grabber.made
                with grabber.daemon() as again:
                    wait_for(lambda: again.status().state == "degraded", "it to notice")
                    assert grabber.acknowledged < grabber.made

        with grabber.daemon() as daemon:
            grabber.await_stored()
            assert daemon.status().state == "running"

        assert [seq for seq, _ in stored(state)] == list(range(1, grabber.made + 1))
        with full(small_disk), grabber.daemon() as daemon:
            assert daemon.status().state == "running", "it ended cleanly, and only reads"
        print(f"{acknowledged} of {grabber.made} acknowledged before the disk was full")


# --- predictions meanwhile ------------------------------------------------------------------------

SENDERS = [f"cam{number:04d}" for number in range(3)]
PER_SECOND = 10
SYNC_SECONDS = 1.5
"""What each sync of a slow disk takes."""
SOON_SECONDS = 0.05
"""From an exit to its prediction, but for one in a hundred."""


@contextlib.contextmanager
def predicting(state: Path, spool: Path) -> Iterator[tuple[Daemon, SpoolPublisher, Delays]]:
    """Yield a daemon that has learned, a publisher, and the delays of its predictions."""
    learned_state(state, 20)
    spool.mkdir()
    with (
        Daemon(small_config(state)) as daemon,
        dial(small_config(spool, daemon.endpoint)) as bus,
        publisher_on(bus, spool, SENDERS) as publisher,
    ):
        delays = Delays(bus)
        delays.walk(publisher, SENDERS, 10, PER_SECOND)
        delays.await_all()
        assert publisher.wait_stored(WAIT_SECONDS)
        yield daemon, publisher, delays


def test_exits_are_predicted_while_nothing_can_be_stored(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    with predicting(quick_path / "state", quick_path / "spool") as (daemon, publisher, delays):
        with monkeypatch.context() as fault:
            fault.setattr(daemon._journal, "commit", refused)
            delays.walk(publisher, SENDERS, 30, 1000.0)
            assert len(delays.await_all()) == 30
            assert publisher.waiting == 30
        assert publisher.wait_stored(WAIT_SECONDS)
        assert daemon.status().predictions == 10 + 30, "each once"


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_exits_are_predicted_while_the_disk_is_full(small_disk: Path, tmp_path: Path) -> None:
    with predicting(small_disk / "state", tmp_path / "spool") as (daemon, publisher, delays):
        with full(small_disk):

            def degraded() -> bool:
                delays.walk(publisher, SENDERS, 100, 1000.0)
                return bool(daemon.status().state == "degraded")

            wait_for(degraded, "it to notice")
            delays.await_all()
            waiting = publisher.waiting
            delays.walk(publisher, SENDERS, 30, 2.0)
            seconds = delays.await_all()
            assert publisher.waiting == waiting + 30, "nothing was stored"
        print(f"{len(seconds)} of 30 predicted, the latest after {max(seconds):.3f} s")
        assert len(seconds) == 30
        assert publisher.wait_stored(WAIT_SECONDS)


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_exits_are_predicted_soon_while_each_sync_takes_long(
    quick_path: Path, disk_watch: Vfs
) -> None:
    """Needs an idle machine."""
    state = quick_path / "state"

    def slow(op: Op) -> None:
        if op.kind == "sync" and Path(op.path).parent == state:
            time.sleep(SYNC_SECONDS)  # the fault

    with (
        disk_watch.watching(slow),
        predicting(state, quick_path / "spool") as (_, publisher, delays),
    ):
        delays.walk(publisher, SENDERS, 300, PER_SECOND)
        seconds = sorted(delays.await_all())
    late = seconds[int(0.99 * len(seconds))]
    print(f"{len(seconds)} exits: 50 % {seconds[150]:.4f} s, 99 % {late:.4f}, {seconds[-1]:.4f}")
    assert late < SOON_SECONDS
