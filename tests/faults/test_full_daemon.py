"""The disk is full under the real daemon.

It reports that, acknowledges nothing that is not stored, starts again on the full disk, and
continues by itself when there is room.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from serving import T0, WAIT_SECONDS, small_config, wait_for
from test_full_disk import full, small_disk

from camtopod.records import Event
from camtopod.serve.bus.session import dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Journal

__all__ = ["small_disk"]
AT_A_TIME = 100
REASON = "cannot write the journal: database or disk is full"
NOW = T0 + 5000.0


class Box:
    """A grabber's spool on another disk, and the number of its events."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._spool = Spool(directory / "spool.db", "b1", 100_000)
        self.publisher = Publisher(self._spool)
        self.made = 0

    @property
    def acknowledged(self) -> int:
        return self.made - self.publisher.waiting

    def publish(self, count: int = AT_A_TIME) -> None:
        events = [
            Event("lobby", "entry", T0 + 0.1 * n) for n in range(self.made, self.made + count)
        ]
        self.made += count
        self.publisher.publish(*events)

    @contextlib.contextmanager
    def at(self, daemon: Daemon) -> Iterator[None]:
        """Attach to this daemon's bus with a new publisher, as after a restart of the box."""
        with contextlib.closing(dial(small_config(self._directory, daemon.endpoint))) as bus:
            self.publisher = Publisher(self._spool)
            self.publisher.attach(bus, ["lobby"])
            yield
            self.publisher.close()

    def close(self) -> None:
        self._spool.close()


def stored(state: Path, copy: Path) -> list[int | None]:
    """Return the numbers of the events in a journal, copied to where there is room."""
    shutil.copytree(state, copy)
    with contextlib.closing(Journal(copy)) as journal:
        return [
            entry.seq
            for _, entry in journal.entries()
            if entry is not None and entry.kind == "event"
        ]


def through_a_full_disk(disk: Path, box: Box, elsewhere: Path) -> None:
    config = small_config(disk / "state")
    with Daemon(config, clock=lambda: NOW) as daemon, box.at(daemon):
        box.publish()
        assert box.publisher.wait_stored(WAIT_SECONDS)
        with full(disk):

            def degraded() -> bool:
                box.publish()
                return bool(daemon.status().state == "degraded")

            wait_for(degraded, "it to notice")
            assert daemon.status().reason == REASON
            assert daemon.unready() == [REASON]
            assert daemon.failing() == [], "starting it again would not help"
            acknowledged = box.acknowledged
            box.publish()
            wait_for(
                lambda: daemon.status().events["received"] == box.made, "all of them to be there"
            )
            daemon.stop()
            assert box.acknowledged == acknowledged
            assert acknowledged <= len(stored(disk / "state", elsewhere / "while full")) < box.made
            with Daemon(config, clock=lambda: NOW) as again, box.at(again):
                wait_for(lambda: again.status().state == "degraded", "it to notice")
                assert box.acknowledged == acknowledged
    with Daemon(config, clock=lambda: NOW) as daemon, box.at(daemon):
        assert box.publisher.wait_stored(WAIT_SECONDS)
        assert daemon.status().state == "running"
    assert stored(disk / "state", elsewhere / "afterwards") == list(range(1, box.made + 1))
    print(
        f"{acknowledged} of {box.made} events acknowledged before the disk was full, none while it was, all afterwards"
    )


@pytest.fixture
def box(tmp_path: Path) -> Iterator[Box]:
    with contextlib.closing(Box(tmp_path)) as one:
        yield one


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_campaign_of_a_daemon_on_a_full_file_system(
    small_disk: Path, box: Box, tmp_path: Path
) -> None:
    through_a_full_disk(small_disk, box, tmp_path)


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_the_harness_sees_what_is_acknowledged_and_not_there(
    small_disk: Path, box: Box, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check of the harness: a journal that claims to have stored what it could not."""
    commit = Journal.commit

    def careless(self: Journal, *given: Any, **more: Any) -> None:
        with contextlib.suppress(sqlite3.Error):
            commit(self, *given, **more)

    with Daemon(small_config(small_disk / "state"), clock=lambda: NOW) as daemon, box.at(daemon):
        monkeypatch.setattr(Journal, "commit", careless)
        with full(small_disk):
            for _ in range(20):
                box.publish()
            assert box.publisher.wait_stored(WAIT_SECONDS)
        assert len(stored(small_disk / "state", tmp_path / "copy")) < box.acknowledged
