"""A grabber reports once that the daemon is gone and once that it is back; a second one ends."""

from __future__ import annotations

import contextlib
import logging
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest
from fake_bus import OneBus
from serving import WAIT_SECONDS, camtopod, free_endpoint, small_config, wait_for

from camtopod.cli.cameras import grabber_connection
from camtopod.cli.cameras.grabber_connection import GrabberConnection
from camtopod.config.settings import BusSettings, Config
from camtopod.serve import bus as buses
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import SpoolPublisher
from camtopod.serve.outbox.spool import OWNER, Spool

CAMERAS = ("hall", "lobby", "yard")
GONE, BACK = "events are kept in the spool", "connected to the daemon again"


class Grabber:
    """`camtopod grab` with cameras that do not exist; ``log`` is its output."""

    def __init__(self, folder: Path, endpoint: str, *arguments: str, log: str = "log") -> None:
        config = folder / "box.toml"
        tables = "".join(f'[cameras.{name}]\nsource = "rtsp://127.0.0.1:1/x"\n' for name in CAMERAS)
        config.write_text(
            f'[bus]\nconnect = ["{endpoint}"]\nconnect_seconds = 0.5\n[state]\ndirectory = "{folder}/box"\n{tables}'
        )
        self._log = folder / log
        with self._log.open("wb") as file:
            self.process = camtopod("--config", str(config), "grab", *arguments, stderr=file)

    @property
    def log(self) -> list[str]:
        return self._log.read_text().splitlines()

    def said(self, what: str) -> list[str]:
        return [line for line in self.log if what in line]

    def end(self) -> None:
        self.process.terminate()
        assert self.process.wait(WAIT_SECONDS) == 0


@pytest.fixture
def started() -> Iterator[list[Grabber]]:
    """End all processes that were started."""
    grabbers: list[Grabber] = []
    yield grabbers
    for grabber in grabbers:
        if grabber.process.poll() is None:
            grabber.process.terminate()
            grabber.process.wait(WAIT_SECONDS)


def at(endpoint: str, folder: Path) -> Config:
    return msgspec.structs.replace(
        small_config(folder / "state"), bus=BusSettings(listen=(endpoint,))
    )


def test_a_daemon_that_is_missing_goes_or_comes_is_one_sentence(
    tmp_path: Path, started: list[Grabber]
) -> None:
    config = at(free_endpoint(), tmp_path)
    grabber = Grabber(tmp_path, config.bus.listen[0], "--camera", "lobby")
    started.append(grabber)
    wait_for(lambda: len(grabber.said(GONE)) == 1, "word that there is none")
    assert "is `camtopod run` running there" in grabber.said(GONE)[0]

    with Daemon(config):
        wait_for(lambda: len(grabber.said(BACK)) == 1, "word that it is there")
    wait_for(lambda: len(grabber.said(GONE)) == 2, "word that it has gone")
    assert "camera lobby: the daemon has gone" in grabber.said(GONE)[1]
    with Daemon(config):
        wait_for(lambda: len(grabber.said(BACK)) == 2, "word that it is back")
    grabber.end()


class Bus(OneBus):
    """A bus on which the test decides when daemons appear and go."""

    def __init__(self) -> None:
        super().__init__()
        self.on_change: Callable[[str, bool], None] = lambda name, alive: None
        self.on_list_sites: Callable[[], None] = lambda: None

    def watch_alive(self, role: str, on_change: Callable[[str, bool], None]) -> None:
        self.on_change = on_change

    def answer_queries(self, *_: object) -> None:
        """Take no queries."""

    def list_sites(self) -> list[str]:
        self.on_list_sites()
        return []


@pytest.fixture
def connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[GrabberConnection]:
    """A connection whose own session is never opened."""
    monkeypatch.setattr(grabber_connection, "_DAEMON_LOOK_SECONDS", 0.0)
    monkeypatch.setattr(GrabberConnection, "_join", lambda _: None)
    grabber = cast(grabber_connection.Grabber, SimpleNamespace(camera="lobby"))
    with contextlib.closing(Spool(tmp_path / "spool.db", "b1", 1000)) as spool:
        publisher = SpoolPublisher(spool)
        yield GrabberConnection(small_config(tmp_path), grabber, publisher, Namespace(), OWNER)


def test_a_daemon_that_comes_while_others_are_looked_for_is_not_missed(
    connection: GrabberConnection, caplog: pytest.LogCaptureFixture
) -> None:
    bus = Bus()
    bus.on_list_sites = lambda: bus.on_change("one", True)
    with caplog.at_level(logging.INFO):
        connection.on_bus(cast(buses.Bus, bus))
        assert caplog.text == ""
        bus.on_change("one", False)
    assert GONE in caplog.text


def test_one_of_two_daemons_may_go(
    connection: GrabberConnection, caplog: pytest.LogCaptureFixture
) -> None:
    """Two that did not see each other have met, and one of them is stopped."""
    bus = Bus()
    with caplog.at_level(logging.INFO):
        connection.on_bus(cast(buses.Bus, bus))
        bus.on_change("one", True)
        caplog.clear()
        bus.on_change("two", True)
        bus.on_change("one", False)
        assert caplog.text == ""
        bus.on_change("two", False)
        assert GONE in caplog.text


# --- a second one ---------------------------------------------------------------------------------


def test_a_second_one_says_so_and_disturbs_nothing(tmp_path: Path, started: list[Grabber]) -> None:
    endpoint = free_endpoint()
    started.append(first := Grabber(tmp_path, endpoint))
    wait_for(lambda: len(first.said("is connecting")) == len(CAMERAS), "all cameras")
    started.append(second := Grabber(tmp_path, endpoint, log="second"))

    assert second.process.wait(WAIT_SECONDS) == 74
    assert len(second.said("spools-of-site/hall.lock is held by another camtopod process")) == 1
    assert first.said("restarting") == []

    one = Grabber(tmp_path, endpoint, "--camera", "lobby", log="one")
    assert one.process.wait(WAIT_SECONDS) == 74
    assert len(one.said("spools-of-site/lobby.lock is held by another camtopod process")) == 1
