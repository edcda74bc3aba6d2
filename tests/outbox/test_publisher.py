"""The publisher: what is stored in the spool reaches a daemon, whatever happens in between."""

from __future__ import annotations

import contextlib
import logging
import queue
import sqlite3
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from serving import Failing, small_config, wait_for

from camtopod import codec
from camtopod.config import Config
from camtopod.records import Event
from camtopod.serve.bus import Bus, dial, open_daemon_session
from camtopod.serve.outbox import SiteLink, SpoolPublisher, publisher, site_link
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.requests import Answer, Batch, read_request
from camtopod.serve.storage import sqlite_file


class Daemon:
    """Answers requests, as a daemon that stores at once."""

    def __init__(self, folder: Path) -> None:
        config = small_config(folder)
        self.stored: dict[tuple[str, str, int], bytes] = {}
        self.seen: list[Event] = []
        self.bus = open_daemon_session(config)
        self.bus.answer_requests("store/*", self._answer)
        self.bus.subscribe(
            "event/*", lambda key, raw: self.seen.append(codec.event_from_msgpack(raw))
        )
        self.bus.announce("daemon", "one")

    def _answer(self, key: str, content: bytes, reply: Callable[[bytes], None]) -> None:
        camera = key.removeprefix("store/")
        request = read_request(content)
        if isinstance(request, Batch):
            self.stored.update({(camera, request.boot, seq): raw for seq, raw in request.events})
        boots = [request.boot] if isinstance(request, Batch) else request.boots
        have = {
            boot: max((k[2] for k in self.stored if k[:2] == (camera, boot)), default=0)
            for boot in boots
        }
        reply(codec.to_msgpack(Answer(have, 100)))


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    one = Daemon(tmp_path)
    with one.bus:
        yield one


@pytest.fixture
def bus(daemon: Daemon, tmp_path: Path) -> Iterator[Bus]:
    with dial(small_config(tmp_path, daemon.bus.endpoint)) as client:
        yield client


@contextlib.contextmanager
def publishing(path: Path, boot: str = "b1") -> Iterator[tuple[SpoolPublisher, Spool]]:
    with (
        contextlib.closing(Spool(path / "spool.db", boot, 100_000)) as spool,
        contextlib.closing(SpoolPublisher(spool)) as one,
    ):
        yield one, spool


def events(count: int, camera: str = "lobby") -> list[Event]:
    return [Event(camera, "entry", float(n)) for n in range(count)]


def test_events_are_stored_once_and_shown_to_who_looks_on(
    daemon: Daemon, bus: Bus, tmp_path: Path
) -> None:
    with publishing(tmp_path) as (one, _):
        one.attach(bus, ["lobby"])
        one.publish(*events(1200), *events(3, "hall"))
        assert one.wait_stored(30.0)

        counters = one.statistics()
    assert (counters["published"], counters["kept"], counters["waiting"]) == (1203, 1203, 0)
    assert len(daemon.stored) == 1203
    assert all(event.spooled for event in daemon.seen)
    wait_for(lambda: len(daemon.seen) > 0, "publications")
    assert sorted(daemon.bus.list_alive("grabber")) == ["hall", "lobby"]


def test_an_answer_that_is_none_is_counted(daemon: Daemon, bus: Bus, tmp_path: Path) -> None:
    with publishing(tmp_path) as (one, _):
        bus.ask = lambda key, payload, seconds, on_answer: on_answer(b"\xc1")  # type: ignore[method-assign]
        one.attach(bus, ["lobby"])
        wait_for(lambda: one.rejects.counts.total() > 0, "the answer")


def test_as_many_events_at_once_as_there_are_are_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that wait in memory are few, but only a spool that cannot be written has them wait."""
    monkeypatch.setattr(publisher, "PENDING_EVENTS_MAX", 8)
    monkeypatch.setattr(publisher, "TRANSACTION_EVENTS_MAX", 5)
    with publishing(tmp_path) as (one, _):
        one.publish(*events(20))
        assert (one.published, one.waiting, one.dropped) == (20, 20, 0)


def test_a_session_that_opens_while_its_link_ends_is_closed(
    daemon: Daemon, bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    links: queue.SimpleQueue[SiteLink] = queue.SimpleQueue()

    def dial_late(config: Config) -> Bus:
        links.get().close(wait=False)
        return bus

    monkeypatch.setattr(site_link, "dial", dial_late)
    with publishing(tmp_path) as (one, _):
        link = SiteLink(small_config(tmp_path), one)
        links.put(link)
        link._thread.join()
        assert bus._end.is_set()


# --- a disk that fails ----------------------------------------------------------------------------


def test_events_wait_in_memory_while_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(publisher, "PENDING_EVENTS_MAX", 8)
    with publishing(tmp_path) as (one, spool):
        good = spool._db
        spool._db = Failing(good, durable=True)  # type: ignore[assignment]
        one.publish(*events(5))
        assert (one.published, one.waiting, one.dropped) == (0, 5, 0), "stored after all"
        spool._db = good
        monkeypatch.setattr(spool, "append", fails)
        one.publish(*events(5))
        assert one.dropped == 2

        monkeypatch.undo()
        one.retry()
        assert (one.published, one.waiting, one.dropped) == (8, 8, 2)
    assert caplog.text.count("events wait in memory") == 1
    assert "can be written again" in caplog.text


def fails(*_: object) -> None:
    raise sqlite3.OperationalError("database or disk is full")


def test_damage_that_the_delivery_finds_ends_the_publisher(
    daemon: Daemon, bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = threading.Event()

    def finds(*_: object) -> None:
        found.set()
        raise sqlite_file.Damaged("the spool is damaged")

    with publishing(tmp_path) as (one, spool):
        one.publish(*events(1))
        monkeypatch.setattr(spool.queue(), "next_batch", finds)
        one.attach(bus)
        assert found.wait(30.0)

        def raises() -> bool:
            try:
                one.retry()
            except sqlite_file.Damaged:
                return True
            return False

        wait_for(raises, "the damage")
