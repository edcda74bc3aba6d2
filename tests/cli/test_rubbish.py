"""Whatever a program of the bus says ends none of those that read it, and hides nobody else."""

from __future__ import annotations

import contextlib
import math
from typing import Any, cast

import msgspec
import pytest
from fake_bus import OneBus

from camtopod.cli import exits, main
from camtopod.cli.commands import bridge, doctor, watch
from camtopod.cli.operator import forget
from camtopod.cli.terminal import SiteState
from camtopod.export.homeassistant import Topics
from camtopod.records import CatchingUp, DaemonStatus, Prediction, Status
from camtopod.serve.bus import Bus
from camtopod.web.feed import Feed
from camtopod.web.outbox import PageQueues

pack = msgspec.msgpack.encode
FINE = pack(Status("stalled", "no pictures"))
DEEP = [b"\x81\xa6reason" + level * b"\x91" + b"\xc0" for level in (400, 1000, 100_000)]
WRONG = [
    {"state": 7},
    {"reason": "\ud800".encode("utf-8", "surrogatepass")},
    {"t": 1 << 63, "cameras": {"lobby": {"events": "x"}}},
    {"cameras": [], "rejects": {1: 2}, "names": None},
]
NUMBERS = [math.nan, math.inf, -1e308, 1e308]
RUBBISH = [
    *(b"", b"\xc1", b"{", b"\xd9\xff", b"\xdf\xff\xff\xff\xff", FINE[:-1], b"\xa2\xff\xfe"),
    *DEEP,
    *map(pack, WRONG),
    *(pack(DaemonStatus("running", t=x, catching_up=CatchingUp(x, x))) for x in NUMBERS),
    *(pack(Prediction("lobby", None, x, None, 1, x, [])) for x in NUMBERS),
]


class RubbishBus(OneBus, contextlib.AbstractContextManager["RubbishBus"]):
    """A bus of which one camera is in order, and all else says ``said``."""

    site = "site"
    said = b""

    def __exit__(self, *_: object) -> None:
        pass

    def query(self, key: str, *_: Any, **__: Any) -> list[tuple[str, bytes]]:
        if key != "status/*":
            return [(key, self.said)]
        return [("status/lobby", FINE), ("status/daemon", self.said), ("status/yard", self.said)]

    def list_alive(self, role: str) -> set[str]:
        return {"lobby"}

    def list_sites(self) -> list[str]:
        return [self.site]

    def tell(self) -> None:
        """Publish it under every key that is subscribed to."""
        for key, readers in self.subscribed.items():
            for one in readers:
                for name in ("daemon", "yard"):
                    one(key.replace("*", name), self.said)
                if key == "status/*":
                    one("status/lobby", FINE)


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> RubbishBus:
    bus = RubbishBus()
    monkeypatch.setattr(doctor, "dial", lambda _: bus)
    monkeypatch.setattr(forget, "dial", lambda _: bus)
    return bus


def test_who_shows_the_site_goes_on(bus: RubbishBus) -> None:
    feed = Feed(cast(Bus, bus), PageQueues(), lambda: 1e9)
    shown = bridge.HomeAssistantState(cast(Bus, bus), Topics("site"), 100)
    seen = SiteState("site")
    bus.subscribe("status/*", seen.on_status)
    bus.subscribe("prediction/*", seen.on_prediction)
    for bus.said in RUBBISH:
        bus.tell()
        rows = {row["id"]: row["reason"] for row in feed.health()["cameras"]}
        assert rows["lobby"] == "no pictures"
        assert "no pictures" in shown.messages(1e9)["camtopod/site/camera/lobby/state"]
        assert "no pictures" in "\n".join(watch.parts(seen, None, 1e9))


def test_commands_say_what_cannot_be_read(
    bus: RubbishBus, capsys: pytest.CaptureFixture[str]
) -> None:
    for bus.said in RUBBISH:
        assert main.main(["--config", "none", "doctor"]) == exits.DONE
        assert 'lobby: {"state": "stalled", "reason": "no pictures"' in capsys.readouterr().out
        for command in (["forget", "yard"], ["rename", "yard", "hall"], ["reset", "--yes"]):
            assert main.main(["--config", "none", *command]) == exits.FAILED
            assert "the answer of the daemon cannot be read" in capsys.readouterr().err
