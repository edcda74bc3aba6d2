"""A journal that comes back shorter is noticed, and filled again from the spools."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from serving import T0, small_config

from camtopod.records import Event
from camtopod.serve.bus import session as buses
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Journal

EVENTS = 60
FILES = ("journal.db", "journal.db-wal")


def raws(directory: Path) -> list[tuple[int | None, bytes]]:
    """Return the payloads in a journal, in order."""
    journal = Journal(directory)
    found = [(entry.seq, entry.raw) for _, entry in journal.entries() if entry is not None]
    journal.close()
    return found


def publish(publisher: Publisher, start: int, stop: int) -> None:
    publisher.publish(*[Event("lobby", "entry", T0 + n) for n in range(start, stop)])
    assert publisher.wait_stored(20)


def taken_back(state: Path, earlier: Path) -> None:
    for name in FILES:
        (state / name).unlink(missing_ok=True)
        if (earlier / name).exists():
            shutil.copyfile(earlier / name, state / name)


def everything_lost(state: Path, earlier: Path) -> None:
    for name in FILES:
        (state / name).unlink(missing_ok=True)


def rubbish(state: Path, earlier: Path) -> None:
    (state / "journal.db").write_bytes(b"rubbish " * 5000)
    (state / "journal.db-wal").unlink(missing_ok=True)


def before_and_after(
    damage: Callable[[Path, Path], None], directory: Path, kept_max: int
) -> tuple[list[tuple[int | None, bytes]], list[tuple[int | None, bytes]], int]:
    """Return the journal before ``damage``, after the next daemon, and the events
    that one recovered.
    """
    state, earlier = directory / "state", directory / "earlier"
    spool = Spool(directory / "spool.db", "boot-1", 1000, kept_max=kept_max)
    publisher = Publisher(spool)
    first = Daemon(small_config(state), clock=lambda: T0 + 100)
    first.start()
    bus = buses.dial(small_config(directory, first.endpoint))
    publisher.attach(bus)
    publish(publisher, 0, EVENTS // 2)
    earlier.mkdir()
    for name in FILES:
        shutil.copyfile(state / name, earlier / name)
    publish(publisher, EVENTS // 2, EVENTS)
    publish(publisher, EVENTS, EVENTS + 1)
    first.stop()
    publisher.close()
    bus.close()
    before = raws(state)
    assert len(before) == EVENTS + 1
    damage(state, earlier)
    again = Publisher(spool)
    with Daemon(small_config(state), clock=lambda: T0 + 100) as second:
        bus = buses.dial(small_config(directory, second.endpoint))
        again.attach(bus, ["lobby"])
        publish(again, EVENTS + 1, EVENTS + 2)
        refilled = second.status().events["stored"] - 1
        again.close()
        bus.close()
    spool.close()
    return before, raws(state), refilled


@pytest.mark.parametrize("damage", [taken_back, everything_lost, rubbish])
def test_the_daemon_gets_back_what_its_journal_lost(
    damage: Callable[[Path, Path], None], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.ERROR):
        before, after, refilled = before_and_after(damage, tmp_path, 1000)
    assert refilled >= EVENTS // 2
    assert "older than it was" in caplog.text
    assert after[:-1] == before


def test_a_spool_that_keeps_nothing_could_not(tmp_path: Path) -> None:
    before, after, refilled = before_and_after(everything_lost, tmp_path, 0)
    assert refilled < EVENTS
    assert len(after) < len(before)
