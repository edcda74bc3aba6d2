"""Answer each request: when its events are stored, or why nothing is taken."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection

from camtopod import codec
from camtopod.serve.ingest.cameras import Cameras, CameraState, Pending
from camtopod.serve.ingest.numbers import Numbers
from camtopod.serve.requests import BATCH_EVENTS_MAX, HELD_SECONDS_MAX, Answer, Batch, Hello, Reason
from camtopod.serve.runtime import Clock

LOOK_SECONDS = 1.0
"""Interval of checks for requests whose events have been held for too long."""


class Answers:
    """The requests under way, one of each camera. Thread-safe.

    room: returns how many further events may be taken.
    alive: cameras whose grabber is on the bus.
    """

    def __init__(
        self,
        numbers: Numbers,
        cameras: Cameras,
        room: Callable[[], int],
        alive: Collection[str],
        steady: Clock,
    ) -> None:
        self._numbers = numbers
        self._cameras = cameras
        self._room = room
        self._alive = alive
        self._steady = steady
        self._next_look = 0.0
        self._mutex = threading.Lock()  # of the cameras' pending requests

    def encode(
        self,
        have: dict[str, int],
        reason: Reason = "",
        detail: str = "",
        late: int = 0,
        refused: int = 0,
    ) -> bytes:
        """Return an answer in MessagePack. All cameras share the room for further events."""
        share = self._room() // max(1, len(self._alive))
        batch = min(max(1, share), BATCH_EVENTS_MAX)
        return codec.to_msgpack(Answer(have, batch, reason, detail, late, refused))

    def greet(self, camera: CameraState, hello: Hello) -> bytes:
        """Return the answer to a hello: the highest stored number of each boot."""
        camera.hello = hello.number
        return self.encode({boot: self._numbers.stored(camera.name, boot) for boot in hello.boots})

    def refuse(self, camera: CameraState, batch: Batch, now: float) -> bytes | None:
        """Return the answer to a batch of which nothing can be taken; None if it can."""
        if batch.number != camera.hello:
            if camera.hello:
                camera.doubled = now
            return self.encode({}, "hello", "another hello has come since")
        if len(batch.events) > self._room():
            return self.encode({}, "busy", "too many events wait to be stored")
        return None

    def wait_for_storage(self, camera: CameraState, pending: Pending) -> None:
        """Keep a request until its events are stored; an earlier one of the camera is ended."""
        with self._mutex:
            before, camera.pending = camera.pending, pending
        if before is not None:
            before.reply(self.encode({}, "held"))

    def note_stored(self, name: str) -> None:
        """Answer the request of a camera if its events are stored."""
        if (camera := self._cameras.get(name)) is None:
            return
        with self._mutex:
            pending = camera.pending
            if pending is None or self._numbers.stored(name, pending.boot) < pending.up_to:
                return
            camera.pending = None
        camera.asked = self._steady()
        have = {pending.boot: self._numbers.stored(name, pending.boot)}
        pending.reply(self.encode(have, late=pending.late, refused=pending.refused))

    def end_held(self, now: float) -> None:
        """Answer requests whose events have waited for too long; the grabbers ask again."""
        if now < self._next_look:
            return
        self._next_look = now + LOOK_SECONDS
        for camera in self._cameras.all():
            with self._mutex:
                pending = camera.pending
                if pending is None or now - pending.since < HELD_SECONDS_MAX:
                    continue
                camera.pending = None
            pending.reply(self.encode({}, "held"))
