"""A grabber reports once that the daemon is gone and once that it is back; a second one ends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from serving import WAIT_SECONDS, camtopod, free_endpoint, small_config, wait_for

from camtopod.config.settings import BusSettings, Config
from camtopod.serve.daemon import Daemon

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
