"""A camera that floods the site harms only itself."""

from __future__ import annotations

import http.client
import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from intake_bench import IntakeBench
from real_daemon import OPEN, RealDaemon, status_over
from serving import free_endpoint, wait_for
from site_of import HERE
from sizes import size

from bench.support.site import resident
from camtopod.codec import to_msgpack
from camtopod.config import Limits
from camtopod.records import Event
from camtopod.serve.ingest.inbox import PUBLISHED_MAX
from camtopod.serve.ingest.intake import EVENTS_MAX
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool

QUIET = [f"quiet{number}" for number in range(19)]
PER_SECOND = 10_000
FLOODED_SHARE = 0.9
"""Of these at least a long flood has to have put, however busy the machine is, to be one."""
MEGABYTE = 1024**2
GROWTH_MAX = 0.05
"""Of memory from the second to the last third of a flood; in the first its buffers fill."""
SOON_FULL = "[learn]\nversion_seconds = 0.5\nlateness_seconds = 1.0\nwindow_events_max = 500\n"
ANY_SETTING = {"camtopod.config.toml_tables:_GONE": ()}
"""`SOON_FULL` has settings that only programs can set."""
"""With these the reorder buffer and the window are full within two seconds; as they are by default,
within 200.
"""
UNGUARDED = {"camtopod.serve.ingest.cameras:EVENTS_PER_SECOND_MAX": 1_000_000}
"""With this all of the flood comes to the learner, which holds it for the next version: by default
once a minute.
"""


class Flooded:
    """The real daemon, a camera that floods it, and quiet cameras without spools."""

    def __init__(self, directory: Path, settings: str | dict[str, object] = "") -> None:
        self.health = free_endpoint().removeprefix("tcp/")
        listen = f'[health]\nlisten = "{self.health}"\n'
        constants = settings if isinstance(settings, dict) else ANY_SETTING
        tables = settings if isinstance(settings, str) else ""
        self.daemon = RealDaemon(directory, f"{OPEN}{listen}{tables}", constants=constants)
        self.bus = self.daemon.dial()
        self.sent = 0
        self._floods: list[subprocess.Popen[bytes]] = []

    def quiet(self) -> None:
        """Publish an event of each quiet camera, and wait until it is stored."""
        self.sent += 1
        for camera in QUIET:
            event = Event(camera, "entry", time.time(), 0.5, 0.5, boot="calm", seq=self.sent)
            self.bus.publish(f"event/{camera}", event, "event")
        wait_for(lambda: self.stored(QUIET[-1]) == self.sent, "the quiet cameras' events")

    def flood(self, seconds: float) -> subprocess.Popen[bytes]:
        """Start a flood."""
        script = [sys.executable, str(HERE / "flood.py"), self.daemon.endpoint, "wild"]
        path = os.pathsep.join(str(folder) for folder in (HERE.parent.parent, HERE))
        flood = subprocess.Popen(
            [*script, str(PER_SECOND), str(seconds)],
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.PIPE,
        )
        self._floods.append(flood)
        return flood

    def status(self) -> dict[str, Any]:
        return status_over(self.bus)

    def stored(self, camera: str) -> int:
        """Return the number of stored events of a camera."""
        return int(self.status()["cameras"].get(camera, {}).get("events", 0))

    def close(self) -> None:
        """End the floods and the daemon."""
        self.bus.close()
        for flood in self._floods:
            flood.kill()
            with flood:  # waits for it, and closes its pipe
                pass
        self.daemon.stop()


@pytest.fixture
def flooded(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Flooded]:
    one = Flooded(tmp_path, getattr(request, "param", ""))
    yield one
    one.close()


class Outcome(NamedTuple):
    """Number of events of a flood, and the memory of daemon and learner during it, MB."""

    said: str
    put: int
    sizes: list[float]

    def growth(self) -> float:
        """Relative growth of memory from the second to the last third."""
        third = len(self.sizes) // 3
        assert third > 0, f"memory was looked at {len(self.sizes)} times only: {self.said}"
        return max(self.sizes[-third:]) / max(self.sizes[third:-third]) - 1.0

    def __str__(self) -> str:
        return f"{self.said}; memory at most {max(self.sizes):.0f} MB, growth {self.growth():.3f}"


def flood(one: Flooded, seconds: float) -> Outcome:
    """Run quiet cameras beside one that floods; they lose nothing."""
    one.quiet()
    wild = one.flood(seconds)
    slowest, sizes = 0.0, []
    while wild.poll() is None:
        put = time.monotonic()
        one.quiet()
        slowest = max(slowest, time.monotonic() - put)
        sizes.append(resident(one.daemon.process.pid) / MEGABYTE)
        time.sleep(0.1)

    put_by_wild = int(wild.communicate()[0])
    status = one.status()
    stored = {camera: status["cameras"][camera]["events"] for camera in QUIET}
    assert stored == dict.fromkeys(QUIET, one.sent)
    assert set(status["dropped"]) <= {"wild", ""}
    assert "".join(one.daemon.said).count("rejected") <= 5, "the log does not flood either"
    return Outcome(
        f"{put_by_wild} put in {seconds:.0f} s, {status['events']}, dropped {status['dropped']};"
        f" {one.sent} of each quiet camera, slowest {slowest:.2f} s",
        put_by_wild,
        sizes,
    )


# How memory goes is seen on a machine that does nothing else: beside others, a few seconds are not
# enough.


@pytest.mark.campaign
@pytest.mark.parametrize("flooded", [SOON_FULL], indirect=True, ids=["soon full"])
def test_with_the_guard_memory_is_flat(flooded: Flooded) -> None:
    outcome = flood(flooded, 12.0)

    print(outcome)
    assert flooded.status()["events"]["flood"] > 0
    assert outcome.growth() <= GROWTH_MAX, str(outcome)


@pytest.mark.campaign
@pytest.mark.parametrize("flooded", [UNGUARDED], indirect=True, ids=["unguarded"])
def test_without_the_guard_the_learner_keeps_the_newest(flooded: Flooded) -> None:
    """It has its own limit for the events of a camera between two versions."""
    outcome = flood(flooded, 12.0)

    print(outcome)
    assert flooded.status()["learner"]["surplus"] > 0, str(outcome)
    assert outcome.growth() <= GROWTH_MAX, str(outcome)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_a_long_flood(flooded: Flooded) -> None:
    """With default settings the window, of 60,000 events, fills last."""
    seconds = size("FLOOD_SECONDS", 240)
    outcome = flood(flooded, seconds)

    print(outcome)
    assert outcome.put >= FLOODED_SHARE * PER_SECOND * seconds, "it was no such flood"
    assert outcome.growth() <= GROWTH_MAX


def readiness(address: str) -> tuple[int, list[str]]:
    """Return status and reasons of ``/readyz``."""
    host, _, port = address.rpartition(":")
    connection = http.client.HTTPConnection(host, int(port), timeout=30)
    try:
        connection.request("GET", "/readyz")
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())["reasons"]
    finally:
        connection.close()


@pytest.mark.parametrize(
    "flooded", [f"{SOON_FULL}[limits]\ncameras_max = 100\n"], indirect=True, ids=["soon full"]
)
def test_a_flood_hurts_only_its_camera_and_invented_names_keep_no_camera_out(
    flooded: Flooded, tmp_path: Path
) -> None:
    flood(flooded, 2.0)
    assert flooded.status()["events"]["flood"] > 0

    for number in range(500):
        event = Event(f"name{number}", "entry", time.time(), 0.5, 0.5)
        flooded.bus.publish(f"event/name{number}", event, "event")
    wait_for(lambda: "too-many-cameras" in flooded.status()["rejects"], "the places to be taken")

    def is_refused() -> bool:
        flooded.bus.publish("event/gate", Event("gate", "entry", time.time(), 0.5, 0.5), "event")
        return "cameras gate, " in flooded.status()["reason"]

    wait_for(is_refused, "the status to name the camera that is refused")
    assert "limits.cameras_max (100) is reached" in flooded.status()["reason"]
    said, reasons = readiness(flooded.health)
    assert (said, len(reasons)) == (503, 1)
    assert "raise limits.cameras_max" in reasons[0]

    # One with a grabber is taken.
    spool = Spool(tmp_path / "spool.db", "boot", 1_000)
    publisher = Publisher(spool)
    publisher.attach(flooded.bus, ["lobby"])
    publisher.publish(*(Event("lobby", "entry", time.time(), 0.5, 0.5) for _ in range(10)))
    assert publisher.wait_stored(30.0)
    publisher.close()
    spool.close()
    assert flooded.stored("lobby") == 10
    flooded.quiet()


def quiet_events_lost(bench: IntakeBench) -> int:
    """Return the number of quiet cameras' events lost beside a flood, before the daemon looks."""
    before = bench.intake.counts["stored"]
    for number in range(PUBLISHED_MAX + 500):
        bench.intake.inbox.on_event("event/wild", b"%d" % number)
    for camera in QUIET:
        bench.publish(camera)
    assert bench.intake.inbox.dropped.total() >= 500
    return before + len(QUIET) - bench.intake.counts["stored"]


def test_each_camera_has_its_own_room(tmp_path: Path) -> None:
    limits = Limits(cameras_max=1 + len(QUIET), commit_seconds=0.0)
    bench = IntakeBench(tmp_path, limits)
    assert quiet_events_lost(bench) > 0, "the canary: cameras that are not known share one"
    for camera in ("wild", *QUIET):
        bench.publish(camera)

    assert quiet_events_lost(bench) == 0
    bench.stop()


def test_a_flood_does_not_fill_the_daemon_while_its_disk_hangs(tmp_path: Path) -> None:
    bench = IntakeBench(tmp_path)
    for camera in ("wild", *QUIET):
        bench.publish(camera)
    for seq in range(1, EVENTS_MAX + 10_000):
        event = Event("wild", "entry", bench.wall, boot="b", seq=seq)
        bench.intake.inbox.on_event("event/wild", to_msgpack(event))
        if seq % PUBLISHED_MAX == 0:
            bench.intake.step()

    for camera in QUIET:
        bench.intake.inbox.on_event(
            f"event/{camera}", to_msgpack(Event(camera, "exit", bench.wall))
        )
    bench.work()

    counts = Counter(name for _, name, _ in bench.stored)
    assert [counts[name] for name in QUIET] == [2] * len(QUIET)
    assert bench.intake.inbox.dropped["wild"] > EVENTS_MAX // 2
    bench.stop()
