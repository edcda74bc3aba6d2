"""Web server and bridge under systemd: one that hangs no longer feeds the watchdog."""

from __future__ import annotations

import contextlib
import threading
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from fake_systemd import Systemd
from serving import WAIT_SECONDS, free_endpoint, small_config, wait_for

from camtopod.cli.commands import bridge, web
from camtopod.cli.main import main
from camtopod.config.settings import BusSettings
from camtopod.mqtt import RetainedMessages
from camtopod.serve import bus as buses
from camtopod.serve.bus.topology_subscriber import TopologySubscriber
from camtopod.web import app

STALL_SECONDS = 1.0


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Systemd]:
    one = Systemd(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", one.address)
    monkeypatch.setenv("WATCHDOG_USEC", "150000")
    yield one
    one.close()


@contextlib.contextmanager
def started(
    module: Any, arguments: list[str], folder: Path, told: Systemd, monkeypatch: pytest.MonkeyPatch
) -> Iterator[str]:
    """Run the command in a thread while the block runs; yield its status when it is ready."""
    stop, status, endpoint = threading.Event(), [-1], free_endpoint()
    monkeypatch.setattr(bridge, "STALL_SECONDS", STALL_SECONDS)
    monkeypatch.setattr(app, "STALL_SECONDS", STALL_SECONDS)
    monkeypatch.setattr(module, "until_signal", lambda: contextlib.nullcontext(stop))
    settings = folder / "c.toml"
    settings.write_text(f'[bus]\nconnect = ["{endpoint}"]\n')
    config = msgspec.structs.replace(small_config(folder), bus=BusSettings(listen=(endpoint,)))
    thread = threading.Thread(
        target=lambda: status.insert(0, main(["--config", str(settings), *arguments]))
    )
    with contextlib.closing(buses.open_daemon_session(config)):
        thread.start()
        try:
            told.wait_for("READY=1")
            told.wait_for("WATCHDOG=1")
            yield next(line for line in told.told if line.startswith("STATUS="))
        finally:
            stop.set()
            thread.join(WAIT_SECONDS)
    assert status[0] == 0
    told.wait_for("STOPPING=1")


def stuck_in(owner: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Make calls of ``owner.name`` block; return a function that releases them."""
    go, real = threading.Event(), getattr(owner, name)

    def blocking(*given: Any, **named: Any) -> Any:
        assert go.wait(WAIT_SECONDS)
        return real(*given, **named)

    monkeypatch.setattr(owner, name, blocking)
    return go.set


def hangs_and_gets_on(told: Systemd, part: str, let_go: Callable[[], None]) -> None:
    """Check that systemd is told of ``part``, and that the watchdog is not fed until
    it is released.
    """
    reason = f"STATUS={part} has made no progress for "
    wait_for(lambda: any(line.startswith(reason) for line in [*told.hear(), *told.told]), reason)
    told.hear(0.2)
    unfed = told.hear(0.5)
    let_go()
    assert "WATCHDOG=1" not in unfed
    wait_for(lambda: "WATCHDOG=1" in told.hear(), "it to be fed again")


def test_a_page_that_hangs_does_not_feed_the_watchdog(
    told: Systemd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with started(web, ["web", "--listen", "127.0.0.1:0"], tmp_path, told, monkeypatch) as said:
        let_go = stuck_in(TopologySubscriber, "update", monkeypatch)
        with contextlib.ExitStack() as stack:
            stack.callback(let_go)
            hangs_and_gets_on(told, "feed", let_go)
            address = said.removeprefix("STATUS=the page is at ")
            with urllib.request.urlopen(address, timeout=WAIT_SECONDS) as answer:
                assert answer.status == 200


def test_a_bridge_that_hangs_does_not_feed_the_watchdog(
    told: Systemd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bridge, "LOOK_SECONDS", 0.05)
    monkeypatch.setattr(RetainedMessages, "__init__", lambda *_: None)
    for name in ("show", "close"):
        monkeypatch.setattr(RetainedMessages, name, lambda *_: None)
    with started(bridge, ["bridge", "mqtt://127.0.0.1"], tmp_path, told, monkeypatch):
        let_go = stuck_in(bridge.HomeAssistantState, "messages", monkeypatch)
        try:
            hangs_and_gets_on(told, "bridge", let_go)
        finally:
            let_go()
