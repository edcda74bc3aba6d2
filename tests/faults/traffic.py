"""Simulated traffic for the fault tests, and a publisher of one camera that may be killed.

`traffic.py ENDPOINT SPOOL CAMERA COUNT SPAN SPEED BEGAN` publishes camera CAMERA's part of
`crossings(COUNT, SPAN)`, SPEED times faster than it happened, as if the first event had happened at
BEGAN (Unix seconds). A restarted publisher continues after the events its spool has had. It ends
when all events are stored. With SPOOL "-" there is no spool: each event is published once.
"""

from __future__ import annotations

import contextlib
import os
import random
import sqlite3
import sys
import time
from pathlib import Path

import msgspec

from camtopod.codec import to_msgpack
from camtopod.config.settings import BusSettings, Config
from camtopod.records import Event
from camtopod.serve.bus.session import BusError, dial
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool

T0 = 1_700_000_000.0
CAMERAS = ("a", "b", "c")
AFTER = "after"
"""Camera of the closing event, after which all earlier events are learned."""


def crossings(count: int, seconds: float, seed: int = 1) -> list[Event]:
    """Simulate objects that cross the view of ``a``, then that of ``b`` or ``c``.

    Each makes four events; they are in order of time.
    """
    chance = random.Random(seed)
    events = []
    for number in range(count):
        t = T0 + chance.uniform(0, seconds - 60)
        for camera, gap in (("a", 0.0), (chance.choice("bc"), chance.gauss(9, 1))):
            t += gap
            events.append(
                Event(camera, "entry", round(t, 3), 0.1 + 0.02 * chance.random(), 0.5, str(number))
            )
            t += chance.uniform(3, 6)
            events.append(
                Event(camera, "exit", round(t, 3), 0.9 - 0.02 * chance.random(), 0.5, str(number))
            )
    return sorted(events, key=lambda event: event.t)


def last_event(seconds: float, camera: str = AFTER) -> Event:
    """Return an event so much later than the rest that all of it is learned."""
    return Event(camera, "entry", T0 + 100 * seconds)


def published_so_far(path: Path) -> int:
    """Return the number of events that a spool has ever had, deleted ones included."""
    if not path.exists():
        return 0
    with contextlib.closing(sqlite3.connect(path)) as database:
        [last] = database.execute("SELECT COALESCE(MAX(id), 0) FROM event").fetchone()
    return int(last)


def publish(
    endpoint: str, spool: str, camera: str, events: list[Event], speed: float, began: float
) -> None:
    """Publish events until all are stored, or published if there is no spool."""
    config = Config(bus=BusSettings(connect=(endpoint,)))
    while True:
        try:
            bus = dial(config)
            break
        except BusError:
            continue

    # Continue after the spool's newest event.
    keep = None if spool == "-" else Spool(Path(spool), os.urandom(8).hex(), 1_000_000)
    publisher = None if keep is None else Publisher(keep)
    if publisher is not None:
        publisher.attach(bus, [camera])
    done = 0 if keep is None else published_so_far(Path(spool))

    # Publish events that are due.
    while done < len(events):
        until = T0 + (time.time() - began) * speed
        due = [event for event in events[done : done + 500] if event.t <= until]
        if publisher is not None:
            publisher.publish(*due)
        for seq, event in enumerate(due if publisher is None else (), start=done + 1):
            bus.publish_raw(
                f"event/{camera}",
                to_msgpack(msgspec.structs.replace(event, boot="none", seq=seq)),
                "event",
            )
        done += len(due)
        time.sleep(0.005)

    # Wait until all are stored.
    if publisher is not None and keep is not None:
        while not publisher.wait_stored(0.5):
            publisher.retry()
        publisher.close()
        keep.close()
    bus.close()


if __name__ == "__main__":
    where, file, which, objects, span, faster, start = sys.argv[1:]
    mine = [event for event in crossings(int(objects), float(span)) if event.camera == which]
    publish(where, file, which, mine, float(faster), float(start))
