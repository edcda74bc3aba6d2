"""A daemon with limited memory, beside cameras just below the flood limit."""

from __future__ import annotations

import contextlib
import random
import resource
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from serving import (
    SPAN_SECONDS,
    T0,
    camtopod as program,
    free_endpoint,
    small_config,
    wait_for,
    walkers,
)
from site_of import READY_SECONDS
from sizes import size

from camtopod.config.settings import BusSettings
from camtopod.records import Event
from camtopod.serve.bus.session import Bus, dial
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool

ADDRESS_SPACE_BYTES = 2_400_000 * 1024
"""As `ulimit -v 2400000`; the libraries alone take most of one gigabyte of it."""
LEARNER_MEGABYTES_MAX = 1024.0
PER_SECOND = 190
"""Below `limits.camera_events_per_second_max`."""


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))


@contextlib.contextmanager
def running(directory: Path, endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run `camtopod run` with the default settings of memory."""
    config = directory / "camtopod.toml"
    config.write_text(f'[bus]\nlisten = ["{endpoint}"]\n[state]\ndirectory = "{directory}/state"\n')
    process = program("--config", str(config), "run", stderr=subprocess.DEVNULL, preexec_fn=limited)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(30)


def status(bus: Bus) -> dict[str, object]:
    answers = bus.query("status/daemon", seconds=5.0, one=True)
    return msgspec.msgpack.decode(answers[0][1]) if answers else {}  # type: ignore[no-any-return]


def learned(bus: Bus, events: int) -> bool:
    found = status(bus)
    counts, learner = found.get("events", {}), found.get("learner", {})
    assert isinstance(counts, dict)
    assert isinstance(learner, dict)
    return (
        counts.get("stored", 0) >= events
        and not counts["waiting"]
        and learner["version"] == found["version"]
    )


def crowd(camera: str, until: float, count: int, chance: random.Random) -> list[Event]:
    """Return passages at random places, 190 events a second, the last at ``until``."""
    began, events = until - count / PER_SECOND, []
    for number in range(count // 2):
        for kind, later in (("entry", 0.0), ("exit", 0.5 / PER_SECOND)):
            t = began + 2 * number / PER_SECOND + later
            place = chance.random(), chance.random()
            events.append(Event(camera, kind, t, *place, track=f"crowd-{number}"))  # type: ignore[arg-type]
    return events


def peak_megabytes(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


@pytest.mark.campaign
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("cameras", [1, 3])
def test_cameras_just_below_the_flood_limit_end_nothing(cameras: int, tmp_path: Path) -> None:
    endpoint, chance, now = free_endpoint(), random.Random(1), time.time()
    known = [msgspec.structs.replace(e, t=e.t - T0 + now - 2 * SPAN_SECONDS) for e in walkers(400)]
    wild = [crowd(f"wild{k}", now, size("CROWD_EVENTS", 20_000), chance) for k in range(cameras)]
    flooding = sorted((event for one in wild for event in one), key=lambda event: event.t)
    client = msgspec.structs.replace(
        small_config(tmp_path, endpoint),
        bus=BusSettings(connect=(endpoint,), connect_seconds=READY_SECONDS),
    )

    with (
        running(tmp_path, endpoint) as daemon,
        dial(client) as bus,
        contextlib.closing(Spool(tmp_path / "spool.db", "boot", 1_000_000)) as spool,
    ):
        publisher = Publisher(spool)
        publisher.attach(bus)
        publisher.publish(*known)
        wait_for(lambda: learned(bus, len(known)), "what is known to be learned", 120)
        before = status(bus)["version"]

        for first in range(
            0, len(flooding), 500
        ):  # a publisher keeps ten thousand at most in memory
            publisher.publish(*flooding[first : first + 500])
        publisher.publish(
            Event("a", "entry", now + 61.0), Event("b", "entry", now + 61.0)
        )  # the last tick is over
        total = len(known) + len(flooding) + 2
        wait_for(
            lambda: learned(bus, total) or daemon.poll() is not None, "all to be learned", 1200
        )

        assert daemon.poll() is None
        after = status(bus)
        assert isinstance(after["version"], int)
        assert isinstance(before, int)
        assert after["version"] > before
        children = Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children").read_text().split()
        peak = max(peak_megabytes(int(child)) for child in children)
        print(
            f"{cameras} cameras: the learner had {peak:.0f} MB at most, version {after['version']}"
        )
        assert peak < LEARNER_MEGABYTES_MAX
        bus.close()
