"""The journal is removed, moved or replaced under the running daemon.

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

import msgspec
import pytest
from serving import T0, WAIT_SECONDS, small_config, wait_for
from test_refill import raws

from camtopod.config.settings import BusSettings
from camtopod.records import Event
from camtopod.serve.bus.session import Bus, dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal_writer import SLOW_SECONDS

NOW = T0 + 10_000.0
BEFORE, AFTER = 100, 20
"""Events that are stored before, and that come after it."""


def removed(state: Path) -> None:
    (state / "journal.db").unlink()


def moved(state: Path) -> None:
    (state / "journal.db").rename(state / "elsewhere.db")


def replaced_by_a_copy(state: Path) -> None:
    shutil.copyfile(state / "journal.db", state / "copy.db")
    (state / "copy.db").rename(state / "journal.db")


def directory_moved(state: Path) -> None:
    state.rename(state.with_name("elsewhere"))


def directory_removed(state: Path) -> None:
    shutil.rmtree(state)


Harm = Callable[[Path], None]
HARMS: tuple[Harm, ...] = (removed, replaced_by_a_copy, directory_removed)


class Grabber:
    """A spool that keeps acknowledged events, and the number of its events."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._spool = Spool(directory / "spool.db", "boot-1", 10_000)
        self.publisher = Publisher(self._spool)
        self.made = 0

    def publish(self, count: int) -> None:
        events = [
            Event("lobby", "entry", T0 + 0.1 * n) for n in range(self.made, self.made + count)
        ]
        self.made += count
        for event in events:
            self.publisher.publish(event)

    @contextlib.contextmanager
    def at(self, endpoint: str) -> Iterator[Bus]:
        """Attach to a daemon's bus with a new publisher, as after a restart."""
        with contextlib.closing(dial(small_config(self._directory, endpoint))) as bus:
            self.publisher = Publisher(self._spool)
            self.publisher.attach(bus, ["lobby"])
            yield bus

    def close(self) -> None:
        self._spool.close()


@pytest.fixture
def grabber(tmp_path: Path) -> Iterator[Grabber]:
    with contextlib.closing(Grabber(tmp_path)) as one:
        yield one


@pytest.mark.parametrize("harm", HARMS)
def test_nothing_is_acknowledged_from_then_on_and_what_the_spools_have_comes_back(
    harm: Harm, grabber: Grabber, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    with Daemon(small_config(state), clock=lambda: NOW) as daemon, grabber.at(daemon.endpoint):
        grabber.publish(BEFORE)
        assert grabber.publisher.wait_stored(20)
        endpoint = daemon.endpoint

        harm(state)
        wait_for(lambda: daemon.status().state == "degraded", "it to notice")
        grabber.publish(AFTER)
        wait_for(
            lambda: daemon.status().events["received"] >= grabber.made, "the events to be there"
        )

        reason = daemon.status().reason
        assert f"{state}/journal.db was removed or replaced while it is in use" in reason
        assert daemon.unready() == [reason]
        assert daemon.failing() == [], "a restart by a supervisor would make the loss final"
        assert caplog.text.count("cannot write the journal, so nothing is acknowledged") == 1
    assert grabber.publisher.waiting == AFTER

    # A spool recognises its daemon by its endpoint.
    config = msgspec.structs.replace(small_config(state), bus=BusSettings(listen=(endpoint,)))
    with Daemon(config, clock=lambda: NOW) as again, grabber.at(again.endpoint):
        assert grabber.publisher.wait_stored(20)
        wait_for(lambda: len(again._journal) >= BEFORE + AFTER, "all events to be there again")
        assert again.status().state == "running"
    assert [seq for seq, _ in raws(state)] == list(range(1, BEFORE + AFTER + 1))


@pytest.mark.parametrize("harm", [moved, directory_moved])
def test_it_goes_on_by_itself_when_the_file_is_back(
    harm: Harm, grabber: Grabber, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    with (
        caplog.at_level(logging.INFO),
        Daemon(small_config(state), clock=lambda: NOW) as daemon,
        grabber.at(daemon.endpoint),
    ):
        grabber.publish(BEFORE)
        assert grabber.publisher.wait_stored(20)
        harm(state)
        wait_for(lambda: daemon.status().state == "degraded", "it to notice")
        grabber.publish(AFTER)
        if harm is moved:
            (state / "elsewhere.db").rename(state / "journal.db")
        else:
            (tmp_path / "elsewhere").rename(state)
        assert grabber.publisher.wait_stored(20)
        assert daemon.status().state == "running"
        epoch = daemon.epoch
    assert "the journal can be written again" in caplog.text
    caplog.clear()
    with Daemon(small_config(state), clock=lambda: NOW) as again:
        assert again.epoch == epoch
    assert "older than it was" not in caplog.text
    assert [seq for seq, _ in raws(state)] == list(range(1, BEFORE + AFTER + 1))


class Hanging:
    """A connection whose COMMIT does not return until allowed."""

    def __init__(self, database: Any, let_in: threading.Event, let_out: threading.Event) -> None:
        self._database, self._let_in, self._let_out = database, let_in, let_out

    def __getattr__(self, name: str) -> Any:
        return getattr(self._database, name)

    def execute(self, statement: str, *parameters: object) -> Any:
        if statement == "COMMIT":
            self._let_in.set()
            assert self._let_out.wait(60)
        return self._database.execute(statement, *parameters)


def test_the_status_is_answered_while_the_disk_hangs(
    grabber: Grabber, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camtopod.serve.storage.journal_writer.SLOW_SECONDS", SLOW_SECONDS / 10)
    let_in, let_out = threading.Event(), threading.Event()
    with (
        Daemon(small_config(tmp_path / "state"), clock=lambda: NOW) as daemon,
        grabber.at(daemon.endpoint),
    ):
        journal = daemon._journal
        journal._db = Hanging(journal._db, let_in, let_out)  # type: ignore[assignment]
        try:
            grabber.publish(1)
            assert let_in.wait(WAIT_SECONDS)
            wait_for(
                lambda: "the disk of the journal does not answer" in daemon.status().reason,
                "the reason",
            )
            assert daemon.status().journal.bytes > 0
            assert daemon.unready() != []
        finally:
            let_out.set()
        assert grabber.publisher.wait_stored(20)
        wait_for(lambda: daemon.status().state == "running", "the disk to answer again")
