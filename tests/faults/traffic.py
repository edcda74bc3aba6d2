"""Programs beside the daemon that may be killed.

traffic.py router ENDPOINT
    prints "ready" and runs until killed
traffic.py zenohd FILE
    runs a router as zenohd does, by its configuration; prints "ready" and runs until killed
traffic.py play FILE FIRST
    prints the lines of a recording from number FIRST (0 is the first) on, each at the time of its
    event
traffic.py flood ENDPOINT CAMERA PER_SECOND SECONDS
    publishes so many valid events a second, and prints their number
traffic.py ask ENDPOINT CAMERA SECONDS
    sends requests of 300 KB, and waits for no answer
traffic.py behind ENDPOINT CAMERA AGO SPEED SECONDS
    delivers events, as a spool does, of AGO seconds ago and on, SPEED times faster than they
    happened, and prints the number of those that are stored
traffic.py publish ENDPOINT FOLDER CAMERA COUNT SPAN SPEED BEGAN
    publishes a camera's part of the events of COUNT walkers within SPAN seconds, SPEED times
    faster than they happened, as if the first had happened at BEGAN (Unix seconds); continues after
    the events that its spool in FOLDER has had, and ends when all are stored. With FOLDER "-" it
    has no spool, and publishes each event once.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import queue
import signal
import sqlite3
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import zenoh
from serving import T0, walkers

from camtopod import client
from camtopod.codec import event_from_json, to_msgpack
from camtopod.config.settings import BusSettings, Config, SiteSettings
from camtopod.records import Event
from camtopod.serve.bus import dial, open_daemon_session
from camtopod.serve.outbox import spool_path
from camtopod.serve.requests import ANSWER_SECONDS_MAX, Answer, Batch, Hello

_STEP_SECONDS = 0.01
_BEHIND_PER_SECOND = 20
"""Events of a camera that is behind, in a second of event time."""
_BEHIND_MORE = 10_000
"""Events that wait behind each of its batches."""


def router(endpoint: str) -> None:
    with open_daemon_session(Config(bus=BusSettings(listen=(endpoint,)))):
        print("ready", flush=True)
        signal.pause()


def zenohd(file: str) -> None:
    with zenoh.open(zenoh.Config.from_file(file)):
        print("ready", flush=True)
        signal.pause()


def play(file: str, first: str) -> None:
    lines = Path(file).read_bytes().splitlines(keepends=True)[int(first) :]
    for due in as_they_fall_due([event_from_json(line) for line in lines], 1.0, T0):
        sys.stdout.buffer.writelines(lines[: len(due)])
        sys.stdout.buffer.flush()
        del lines[: len(due)]


def flood(endpoint: str, camera: str, per_second: str, seconds: str) -> None:
    began, count = time.monotonic(), 0
    with dial(Config(bus=BusSettings(connect=(endpoint,)))) as bus:
        while (elapsed := time.monotonic() - began) < float(seconds):
            for count in range(count + 1, int(elapsed * int(per_second)) + 1):  # noqa: B020
                event = Event(camera, "entry", time.time(), 0.5, 0.5, str(count), "wild", count)
                bus.publish_raw(f"event/{camera}", to_msgpack(event), "event")
            time.sleep(_STEP_SECONDS)
    print(count, flush=True)


def ask(endpoint: str, camera: str, seconds: str) -> None:
    until, request = time.monotonic() + float(seconds), os.urandom(300_000)
    bus = dial(Config(bus=BusSettings(connect=(endpoint,))))
    while time.monotonic() < until:
        bus.ask(f"store/{camera}", request, float(seconds), lambda answer: None)
    os._exit(0)


def behind(endpoint: str, camera: str, ago: str, speed: str, seconds: str) -> None:
    began, first, have = time.time(), time.time() - float(ago), 0
    answers: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    with dial(Config(bus=BusSettings(connect=(endpoint,)))) as bus:

        def answer(request: Hello | Batch) -> Answer:
            bus.ask(f"store/{camera}", to_msgpack(request), ANSWER_SECONDS_MAX, answers.put)
            return msgspec.msgpack.decode(answers.get() or b"", type=Answer)

        answer(Hello("h", ["b"]))
        while (elapsed := time.time() - began) < float(seconds):
            due = range(have + 1, 2 + int(elapsed * float(speed) * _BEHIND_PER_SECOND))
            times = {seq: first + (seq - 1) / _BEHIND_PER_SECOND for seq in due}
            events = [(seq, to_msgpack(Event(camera, "entry", t))) for seq, t in times.items()]
            if events:
                have = answer(Batch("h", "b", have, events, _BEHIND_MORE)).have["b"]
            time.sleep(_STEP_SECONDS)
    print(have, flush=True)


def publish(
    endpoint: str, folder: str, camera: str, count: str, span: str, speed: str, began: str
) -> None:
    events = [e for e in walkers(int(count), seconds=float(span)) if e.camera == camera]
    if folder == "-":
        with dial(Config(bus=BusSettings(connect=(endpoint,)))) as bus:
            numbers = itertools.count(1)
            for due in as_they_fall_due(events, float(speed), float(began)):
                for event in due:
                    numbered = msgspec.structs.replace(event, boot="none", seq=next(numbers))
                    bus.publish(f"event/{camera}", numbered, "event")
        return

    had = events_ever_in(spool_path(Path(folder), SiteSettings().name, camera))
    with client.Publisher(camera, connect=endpoint, state=folder) as publisher:
        for due in as_they_fall_due(events[had:], float(speed), float(began)):
            publisher.publish(*due)
        while not publisher.wait_stored(1.0):
            pass


def events_ever_in(spool: Path) -> int:
    """Return the number of events that a spool has ever had, deleted ones included."""
    if not spool.exists():
        return 0
    with contextlib.closing(sqlite3.connect(spool)) as database:
        [last] = database.execute("SELECT COALESCE(MAX(id), 0) FROM event").fetchone()
    return int(last)


def as_they_fall_due(events: list[Event], speed: float, began: float) -> Iterator[list[Event]]:
    """Yield the events as their time comes."""
    done = 0
    while done < len(events):
        until = T0 + (time.time() - began) * speed
        due = [event for event in events[done : done + 500] if event.t <= until]
        done += len(due)
        yield due
        time.sleep(_STEP_SECONDS)


if __name__ == "__main__":
    parts = (router, zenohd, play, flood, ask, behind, publish)
    {part.__name__: part for part in parts}[sys.argv[1]](*sys.argv[2:])
