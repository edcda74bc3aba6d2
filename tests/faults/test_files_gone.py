"""The journal is removed, replaced or damaged, under the running daemon or between two of them.

From then on nothing is acknowledged, the fault is reported, and after a restart nothing is missing
that a spool still has.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from grabber import Grabber, stored
from serving import WAIT_SECONDS, wait_for

BEFORE, AFTER = 100, 20
"""Events that are stored before, and that come after it."""
FILES = ("journal.db", "journal.db-wal")


@pytest.fixture
def grabber(tmp_path: Path) -> Iterator[Grabber]:
    with contextlib.closing(Grabber(tmp_path)) as one:
        yield one


# --- under the running daemon ---------------------------------------------------------------------


def replaced_by_a_copy(state: Path) -> None:
    shutil.copyfile(state / "journal.db", state / "copy.db")
    (state / "copy.db").rename(state / "journal.db")


LOSSES: dict[str, Callable[[Path], object]] = {
    "removed": lambda state: (state / "journal.db").unlink(),
    "replaced by a copy": replaced_by_a_copy,
    "directory removed": shutil.rmtree,
}


@pytest.mark.parametrize("loss", LOSSES)
def test_nothing_is_acknowledged_from_then_on_and_what_the_spools_have_comes_back(
    loss: str, grabber: Grabber, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    with grabber.daemon() as daemon:
        grabber.attach()
        grabber.publish(BEFORE)
        grabber.await_stored()
        LOSSES[loss](state)
        wait_for(lambda: daemon.status().state == "degraded", "it to notice")
        received = daemon.status().events.received
        grabber.publish(AFTER)
        wait_for(lambda: daemon.status().events.received > received, "some of the events")

        reason = daemon.status().reason
        assert f"{state}/journal.db was removed or replaced while it is in use" in reason
        assert daemon.unready() == [reason]
        assert daemon.failing() == [], "a restart by a supervisor would make the loss final"
        assert caplog.text.count("cannot write the journal, so nothing is acknowledged") == 1
    assert grabber.publisher.waiting == AFTER

    with grabber.daemon() as daemon:
        grabber.await_stored()
        wait_for(lambda: daemon.status().journal.entries == grabber.made, "all events")
        assert daemon.status().state == "running"
    assert [seq for seq, _ in stored(state)] == list(range(1, grabber.made + 1))


@pytest.mark.parametrize("name", ["state", "state/journal.db"])
def test_it_goes_on_by_itself_when_the_file_is_back(
    name: str, grabber: Grabber, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    with caplog.at_level(logging.INFO), grabber.daemon() as daemon:
        grabber.attach()
        grabber.publish(BEFORE)
        grabber.await_stored()
        (tmp_path / name).rename(tmp_path / f"{name}-elsewhere")
        wait_for(lambda: daemon.status().state == "degraded", "it to notice")
        grabber.publish(AFTER)

        (tmp_path / f"{name}-elsewhere").rename(tmp_path / name)

        grabber.await_stored()
        assert daemon.status().state == "running"
    assert "the journal can be written again" in caplog.text
    assert [seq for seq, _ in stored(state)] == list(range(1, grabber.made + 1))


class Hanging:
    """A connection whose COMMIT does not return until allowed."""

    def __init__(self, database: Any, let_in: threading.Event, let_out: threading.Event) -> None:
        self._database = database
        self._let_in = let_in
        self._let_out = let_out

    def __getattr__(self, name: str) -> Any:
        return getattr(self._database, name)

    def execute(self, statement: str, *parameters: object) -> Any:
        if statement == "COMMIT":
            self._let_in.set()
            assert self._let_out.wait(60)
        return self._database.execute(statement, *parameters)


def test_the_status_is_answered_while_the_disk_hangs(
    grabber: Grabber, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camtopod.serve.daemon.STALL_SECONDS", 0.5)
    let_in, let_out = threading.Event(), threading.Event()
    with grabber.daemon() as daemon:
        grabber.attach()
        journal = daemon._journal
        journal._db = Hanging(journal._db, let_in, let_out)  # type: ignore[assignment]
        try:
            grabber.publish(1)
            assert let_in.wait(WAIT_SECONDS)
            said = "store has made no progress"
            wait_for(lambda: said in daemon.status().reason, "the reason")
            assert daemon.status().journal.bytes > 0
            assert daemon.unready() != []
        finally:
            let_out.set()
        grabber.await_stored()
        wait_for(lambda: daemon.status().state == "running", "the disk to answer again")


# --- between two daemons --------------------------------------------------------------------------


def everything_lost(state: Path, earlier: Path) -> None:
    for name in FILES:
        (state / name).unlink(missing_ok=True)


def taken_back(state: Path, earlier: Path) -> None:
    everything_lost(state, earlier)
    shutil.copytree(earlier, state, dirs_exist_ok=True)


def rubbish(state: Path, earlier: Path) -> None:
    everything_lost(state, earlier)
    (state / "journal.db").write_bytes(b"rubbish " * 5000)


def journals_around(
    damage: Callable[[Path, Path], None], directory: Path, kept_max: int
) -> tuple[list[tuple[int | None, bytes]], list[tuple[int | None, bytes]]]:
    """Return the journal before ``damage``, and after the next daemon and one more event."""
    state, earlier = directory / "state", directory / "earlier"
    with contextlib.closing(Grabber(directory, kept_max=kept_max)) as grabber:
        with grabber.daemon():
            grabber.attach()
            grabber.publish(BEFORE)
            grabber.await_stored()
            earlier.mkdir()
            for name in FILES:
                shutil.copyfile(state / name, earlier / name)
            for _ in range(2):  # only what was stored before is kept as stored
                grabber.publish(AFTER)
                grabber.await_stored()
        before = stored(state)
        assert [seq for seq, _ in before] == list(range(1, grabber.made + 1))
        damage(state, earlier)
        with grabber.daemon() as daemon:
            grabber.publish(1)
            wait_for(lambda: daemon.status().events.stored > 0, "the next event")
            grabber.await_stored()
    return before, stored(state)


@pytest.mark.parametrize("damage", [taken_back, everything_lost, rubbish])
def test_the_daemon_gets_back_what_its_journal_lost(
    damage: Callable[[Path, Path], None], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    before, after = journals_around(damage, tmp_path, kept_max=1_000)

    assert "older than it was" in caplog.text
    assert after[:-1] == before


def test_a_spool_that_keeps_nothing_could_not(tmp_path: Path) -> None:
    before, after = journals_around(everything_lost, tmp_path, kept_max=0)

    assert 0 < len(after) < len(before)
