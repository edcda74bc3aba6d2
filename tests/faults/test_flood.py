"""A camera that floods the site harms only itself."""

from __future__ import annotations

import http.client
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest
from camtopod.serve.ingest.inbox import Inbox, Message
from serving import camtopod, free_endpoint, wait_for
from site_of import HERE
from sizes import size

from bench.support.site import resident
from camtopod.config.settings import BusSettings, Config
from camtopod.records import Event
from camtopod.serve.bus.session import Bus, dial
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
"""With these the reorder buffer and the window are full within two seconds; as they are by default,
within 200.
"""
UNGUARDED = "[limits]\ncamera_events_per_second_max = 1_000_000\n"
"""With this all of the flood comes to the learner, which holds it for the next version: by default
once a minute.
"""


class Flooded:
    """The real daemon, a camera that floods it, and quiet cameras without spools."""

    def __init__(self, directory: Path, settings: str = "") -> None:
        self.endpoint, self.health = free_endpoint(), free_endpoint().removeprefix("tcp/")
        config = directory / "camtopod.toml"
        bus_and_state = (
            f'[bus]\nlisten = ["{self.endpoint}"]\n[state]\ndirectory = "{directory}/state"\n'
        )
        config.write_text(f'{bus_and_state}[health]\nlisten = "{self.health}"\n{settings}')
        self.daemon = camtopod("--config", str(config), "run", stderr=subprocess.PIPE)
        self.said: list[bytes] = []
        ready: queue.SimpleQueue[None] = queue.SimpleQueue()

        def read() -> None:
            for line in self.daemon.stderr or ():
                self.said.append(line)
                if b"ready at" in line:
                    ready.put(None)

        self._reader = threading.Thread(target=read, daemon=True)
        self._reader.start()
        ready.get(timeout=60)
        self.bus: Bus = dial(Config(bus=BusSettings(connect=(self.endpoint,))))
        self.sent = 0
        self._floods: list[subprocess.Popen[bytes]] = []

    def quiet(self, times: int = 1) -> None:
        """Publish an event of each quiet camera."""
        for _ in range(times):
            self.sent += 1
            for camera in QUIET:
                event = Event(camera, "entry", time.time(), 0.5, 0.5, boot="calm", seq=self.sent)
                self.bus.publish(f"event/{camera}", event, "event")

    def flood(self, seconds: float) -> subprocess.Popen[bytes]:
        """Start a flood."""
        path = os.pathsep.join(str(folder) for folder in (HERE.parent.parent, HERE))
        flood = subprocess.Popen(
            [
                sys.executable,
                str(HERE / "flood.py"),
                self.endpoint,
                "wild",
                str(PER_SECOND),
                str(seconds),
            ],
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.PIPE,
        )
        self._floods.append(flood)
        return flood

    def status(self) -> dict[str, Any]:
        """Return the daemon's status, asking again if a busy machine delays the answer."""
        answers: list[tuple[str, bytes]] = []

        def answered() -> bool:
            answers[:] = self.bus.query("status/daemon", one=True)
            return bool(answers)

        wait_for(answered, "the daemon to answer")
        status: dict[str, Any] = msgspec.msgpack.decode(answers[0][1])
        return status

    def stored(self, camera: str) -> int:
        """Return the number of stored events of a camera."""
        return int(self.status()["cameras"].get(camera, {}).get("events", 0))

    def resident_bytes(self) -> int:
        """Return the memory of the daemon and its learner, bytes."""
        return resident(self.daemon.pid)

    def close(self) -> None:
        """End the daemon and the floods."""
        self.bus.close()
        for flood in self._floods:
            flood.kill()
            with flood:  # waits for it, and closes its pipe
                pass
        self.daemon.kill()
        self.daemon.wait()
        self._reader.join()
        assert self.daemon.stderr is not None
        self.daemon.stderr.close()


@pytest.fixture
def flooded(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Flooded]:
    one = Flooded(tmp_path, getattr(request, "param", ""))
    yield one
    one.close()


class Outcome(NamedTuple):
    """Events of a flood, and the memory of the daemon and its learner during it, MB."""

    said: str
    put: int
    sizes: list[float]

    def thirds(self) -> tuple[float, float, float]:
        """Peak memory in each third of the flood, MB."""
        third = len(self.sizes) // 3
        assert third > 0, f"memory was looked at {len(self.sizes)} times only: {self.said}"
        return max(self.sizes[:third]), max(self.sizes[third:-third]), max(self.sizes[-third:])

    def growth(self) -> float:
        """Relative growth of memory from the second to the last third."""
        _, full, last = self.thirds()
        return last / full - 1.0

    def __str__(self) -> str:
        filling, full, last = self.thirds()
        return (
            f"{self.said}; memory at most {filling:.0f} MB in the first third, {full:.0f} MB in the second, "
            f"{last:.0f} MB in the last, {self.sizes[-1]:.0f} MB at the end"
        )


def flood(one: Flooded, seconds: float) -> Outcome:
    """Run quiet cameras beside one that floods; they lose nothing."""
    one.quiet()
    wait_for(lambda: one.stored(QUIET[-1]) == 1, "the quiet cameras to be known")
    wild = one.flood(seconds)
    slowest, sizes = 0.0, []
    while wild.poll() is None:
        put = time.monotonic()
        one.quiet()
        wait_for(lambda: one.stored(QUIET[-1]) == one.sent, "a quiet camera's event to be stored")
        slowest = max(slowest, time.monotonic() - put)
        sizes.append(one.resident_bytes() / MEGABYTE)
        time.sleep(0.1)
    put_by_wild = int(wild.communicate()[0])
    status = one.status()
    assert [status["cameras"][camera]["events"] for camera in QUIET] == [one.sent] * len(QUIET)
    assert set(status["dropped"]) <= {"wild", ""}
    assert sum("rejected" in line.decode() for line in one.said) <= 5, (
        "the log does not flood either"
    )
    kept = status["cameras"]["wild"]["events"]
    return Outcome(
        f"{put_by_wild} put in {seconds:.0f} s, {kept} learned, {status['events']['flood']} too many, "
        f"dropped {status['dropped']}; {one.sent * len(QUIET)} of the quiet cameras stored, slowest {slowest:.2f} s",
        put_by_wild,
        sizes,
    )


def test_growth_is_from_the_second_third_to_the_last() -> None:
    assert Outcome("", 0, [1.0, 5.0, 2.0, 2.0, 3.0, 3.0]).growth() == pytest.approx(0.5)
    assert Outcome("", 0, [1.0, 1.0, 3.0, 3.0, 3.0, 3.0]).growth() == 0.0


@pytest.mark.parametrize("flooded", [SOON_FULL], indirect=True, ids=["soon full"])
def test_a_flood_hurts_only_its_camera(flooded: Flooded) -> None:
    flood(flooded, 6.0)
    assert flooded.status()["events"]["flood"] > 0


# How memory goes is seen on a machine that does nothing else: beside others, a few seconds are not
# enough.


@pytest.mark.campaign
@pytest.mark.parametrize("flooded", [SOON_FULL], indirect=True, ids=["soon full"])
def test_with_the_guard_memory_is_flat(flooded: Flooded) -> None:
    outcome = flood(flooded, 12.0)
    assert outcome.growth() <= GROWTH_MAX, str(outcome)


@pytest.mark.campaign
@pytest.mark.parametrize("flooded", [UNGUARDED], indirect=True, ids=["unguarded"])
def test_without_the_guard_the_learner_keeps_the_newest(flooded: Flooded) -> None:
    """It has its own limit for the events of a camera between two versions."""
    outcome = flood(flooded, 12.0)
    assert flooded.status()["learner"]["surplus"] > 0, str(outcome)
    assert outcome.growth() <= GROWTH_MAX, str(outcome)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_a_long_flood(flooded: Flooded) -> None:
    """With default settings the window, of 60,000 events, fills last."""
    seconds = size("FLOOD_SECONDS", 600)
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


NAMES = 5_000


def test_invented_names_keep_no_camera_out(flooded: Flooded, tmp_path: Path) -> None:
    """A new camera without a grabber is refused with a reason; one with a grabber is accepted."""
    flooded.quiet()
    wait_for(lambda: flooded.stored(QUIET[-1]) == 1, "the quiet cameras to be known")
    for number in range(NAMES):
        flooded.bus.publish(
            f"event/name{number}", Event(f"name{number}", "entry", time.time(), 0.5, 0.5), "event"
        )
    wait_for(
        lambda: flooded.status()["rejects"].get("too-many-cameras", 0) > 0, "the places to be taken"
    )

    def refused() -> bool:
        flooded.bus.publish("event/gate", Event("gate", "entry", time.time(), 0.5, 0.5), "event")
        return "camera gate and " in flooded.status()["reason"]

    wait_for(refused, "the status to name the camera that is refused")
    status = flooded.status()
    assert status["state"] == "degraded"
    assert (
        "refused, as limits.cameras_max (1000) is reached; the cameras with the fewest events are name"
        in status["reason"]
    )
    said, reasons = readiness(flooded.health)
    assert (said, len(reasons)) == (503, 1)
    assert "raise limits.cameras_max" in reasons[0]

    spool = Spool(tmp_path / "spool.db", "boot", 1_000)
    publisher = Publisher(spool)
    publisher.attach(flooded.bus, ["lobby"])
    publisher.publish(*(Event("lobby", "entry", time.time(), 0.5, 0.5) for _ in range(10)))
    assert publisher.wait_stored(30.0), "all are acknowledged"
    wait_for(lambda: flooded.stored("lobby") == 10, "the camera with a grabber to be stored")
    flooded.quiet()
    wait_for(lambda: flooded.stored(QUIET[-1]) == 2, "the quiet cameras to be stored as before")
    spool.close()


def quiet_events_lost(known: bool) -> int:
    """Return the number of quiet cameras' events lost by an inbox that is emptied too slowly."""
    inbox = Inbox(2_000, 500, 100, lambda camera: known)
    got = 0
    for number in range(100):
        for n in range(1_000):
            inbox.put(Message("wild", b"%d" % n))
        for camera in QUIET:
            inbox.put(Message(camera, b"%d" % number))
        got += sum(message.camera in QUIET for message in inbox.take(300))
    while messages := inbox.take(1_000):
        got += sum(message.camera in QUIET for message in messages)
    return 100 * len(QUIET) - got


def test_each_camera_has_its_turn() -> None:
    assert quiet_events_lost(known=True) == 0
    assert quiet_events_lost(known=False) > 0, (
        "the canary: in one queue for all a flood starves the others"
    )
