"""Answer each request: when its events are stored, or why nothing is taken."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Collection

from camtopod import codec
from camtopod.serve.ingest.cameras import CameraIntake, Cameras, Pending
from camtopod.serve.ingest.numbers import Numbers
from camtopod.serve.requests import BATCH_EVENTS_MAX, HELD_SECONDS_MAX, Answer, Reason
from camtopod.serve.runtime import Clock

LOOK_SECONDS = 1.0
"""Interval at which requests are looked for whose events have waited for too long."""


class PendingRequests:
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
        self._mutex = threading.Lock()  # of the cameras' pending requests
        self._last_look = -math.inf

    def encode(
        self,
        have: dict[str, int],
        reason: Reason = "",
        detail: str = "",
        late: int = 0,
        refusals: int = 0,
    ) -> bytes:
        """Return an answer in MessagePack. All cameras share the room for further events."""
        batch = min(max(1, self._room() // max(1, len(self._alive))), BATCH_EVENTS_MAX)
        return codec.to_msgpack(Answer(have, batch, reason, detail, late, refusals))

    def wait_for_storage(self, camera: CameraIntake, pending: Pending) -> None:
        """Keep a request until its events are stored; an earlier one of the camera is ended."""
        if camera.pending is not None:
            self._end(camera, camera.pending, self.encode({}, "held"))
        camera.pending = pending

    def note_stored(self, name: str) -> None:
        """Answer the request of a camera if its events are stored."""
        camera = self._cameras.get(name)
        if camera is None or (pending := camera.pending) is None:
            return
        have = self._numbers.stored(name, pending.boot)
        if have >= pending.up_to:
            camera.asked = self._steady()
            answer = self.encode({pending.boot: have}, late=pending.late, refusals=pending.refused)
            self._end(camera, pending, answer)

    def end_held(self, now: float) -> None:
        """Answer requests whose events have waited for too long; the grabbers ask again."""
        if now - self._last_look < LOOK_SECONDS:
            return
        self._last_look = now
        for camera in self._cameras.all():
            pending = camera.pending
            if pending is not None and now - pending.since >= HELD_SECONDS_MAX:
                self._end(camera, pending, self.encode({}, "held"))

    def _end(self, camera: CameraIntake, pending: Pending, answer: bytes) -> None:
        """Answer a request, unless another thread has done so."""
        with self._mutex:
            if camera.pending is not pending:
                return
            camera.pending = None
        pending.reply(answer)
