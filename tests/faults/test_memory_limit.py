"""A daemon with limited memory, beside cameras just below the flood limit."""

from __future__ import annotations

import contextlib
import random
import resource
import time
from pathlib import Path

import msgspec
import pytest
from real_daemon import OPEN, RealDaemon, status_over
from serving import SPAN_SECONDS, T0, wait_for, walkers
from sizes import size

from camtopod.records import Event
from camtopod.serve.bus.session import Bus
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool

ADDRESS_SPACE_BYTES = 2_400_000 * 1024
"""As `ulimit -v 2400000`; the libraries alone take most of one gigabyte of it."""
LEARNER_MEGABYTES_MAX = 1024.0
PER_SECOND = 190
"""Below `limits.camera_events_per_second_max`."""


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))


def learned(bus: Bus, events: int) -> bool:
    """Return True if so many events are stored and learned, and the newest version is out."""
    status = status_over(bus)
    counts = status["events"]
    done = counts["stored"] >= events and not counts["waiting"]
    return bool(done and status["learner"]["version"] == status["version"])


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
def test_cameras_just_below_the_flood_limit_end_nothing(tmp_path: Path) -> None:
    chance, now = random.Random(1), time.time()
    known = [msgspec.structs.replace(e, t=e.t - T0 + now - 2 * SPAN_SECONDS) for e in walkers(400)]
    wild = [crowd(f"wild{k}", now, size("CROWD_EVENTS", 10_000), chance) for k in range(3)]
    flooding = sorted((event for one in wild for event in one), key=lambda event: event.t)

    with contextlib.ExitStack() as stack:
        daemon = RealDaemon(tmp_path, OPEN, preexec_fn=limited)
        stack.callback(daemon.stop)
        bus = stack.enter_context(daemon.dial())
        spool = stack.enter_context(contextlib.closing(Spool(tmp_path / "s.db", "b", 1_000_000)))
        publisher = stack.enter_context(contextlib.closing(Publisher(spool)))
        publisher.attach(bus)
        publisher.publish(*known)
        wait_for(lambda: learned(bus, len(known)), "what is known to be learned", 120)
        before = status_over(bus)["version"]

        for first in range(0, len(flooding), 500):
            publisher.publish(*flooding[first : first + 500])
        last = [Event(camera, "entry", now + 61.0) for camera in "ab"]  # the last tick is over
        publisher.publish(*last)
        total = len(known) + len(flooding) + len(last)
        ended = daemon.process.poll
        wait_for(lambda: learned(bus, total) or ended() is not None, "all to be learned", 1200)

        assert ended() is None
        assert status_over(bus)["version"] > before
        pid = daemon.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        peak = max(peak_megabytes(int(child)) for child in children)
        print(f"the learner had {peak:.0f} MB at most")
        assert peak < LEARNER_MEGABYTES_MAX
