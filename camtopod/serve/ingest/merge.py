"""Merge the events of all cameras by time, also while some deliver a backlog.

When the daemon or the network was away, every spool delivers its backlog, some sooner than others.
If events were learned in the order of arrival, the first backlog would make all others late. So
each camera that has more to deliver is waited for, and events are released by time, up to what all
these cameras have reached. A camera whose backlog is older than the released events is late
anyway, so nothing waits for it.

An event up to a minute ahead of this machine's clock waits until its time has come: learned at
once, it would make other cameras' events late. The events that its camera sends after it wait, too,
so a fast clock delays only its own camera.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable

from camtopod.serve.ingest.cameras import CameraState
from camtopod.serve.ingest.event_clock import EventClock
from camtopod.serve.ingest.received import Received

SETTLE_SECONDS = 5.0
"""Time that other cameras get to tell of their backlogs: after the start, and after the first.

A backlog may be a single batch, as after an outage of a minute.
"""
EARLY_SECONDS_MAX = 1.0
"""An event up to this much ahead of the clock need not wait; far below the lateness."""
STUCK_SECONDS_MAX = 120.0
"""A camera that comes no nearer to the clock for this long is waited for no longer.

The time in which one of its batches is held does not count.
"""
NEARER_SECONDS = 1.0
"""Change of the distance to the clock that counts as nearer."""


class Merger:
    """Events of all cameras that wait to be released; used by one thread.

    In all methods ``wall`` is this machine's time in Unix seconds, ``now`` that of a clock that
    never steps.

    Nothing is released in the first `SETTLE_SECONDS`, nor for as long after the first backlog that
    is reported after a hello: those of other cameras may follow.

    lateness: the learner's (seconds). An event older than this is of a backlog.
    ahead_max: events further ahead of the clock (seconds) are stored and not learned.
    """

    def __init__(
        self, lateness: float, ahead_max: float, event_clock: EventClock, now: float
    ) -> None:
        self._lateness = lateness
        self._ahead_max = ahead_max
        self._nothing_before = now + SETTLE_SECONDS
        self._looked = now
        self.said_hello = True
        """True if a camera has come back since the last wait for backlogs, perhaps with one."""
        self._holding: dict[str, CameraState] = {}  # cameras with waiting events
        self.waiting = 0
        """Number of events that wait."""
        self._behind: dict[str, CameraState] = {}  # cameras that may be waited for
        self._event_clock = event_clock

    def add(self, camera: CameraState, events: list[Received], wall: float) -> None:
        """Add events of a camera, in its order; note how far it has come."""
        for received in events:
            event = received.event
            if event is not None:
                camera.ahead = event.t - wall
                if camera.ahead > self._ahead_max:
                    received = received.only_stored("future")
                else:
                    camera.reached = max(camera.reached, event.t)
            camera.waiting.append((camera.reached, received))
        self.waiting += len(events)
        if camera.waiting:
            self._holding[camera.name] = camera

    def note_request(self, camera: CameraState, more: int, wall: float, now: float) -> None:
        """Note that a batch of a camera has come, and how many events wait behind it."""
        camera.more = more
        camera.asked = now
        if camera.reached < self._event_clock.newest:
            self._behind.pop(camera.name, None)
            return
        known = (t for t, _ in camera.waiting if t > -math.inf)
        if self.said_hello and wall - next(known, wall) > self._lateness:
            self.said_hello = False
            self._nothing_before = max(self._nothing_before, now + SETTLE_SECONDS)
        if wall - camera.reached <= self._lateness:
            self._behind.pop(camera.name, None)
        else:
            self._behind.setdefault(camera.name, camera)

    def release(self, wall: float, now: float, room: int) -> list[Received]:
        """Return the events whose turn has come, at most ``room``, by time."""
        limit = min(self._limit(wall, now), wall + EARLY_SECONDS_MAX)
        heads = [
            (camera.waiting[0][0], name)
            for name, camera in self._holding.items()
            if camera.waiting[0][0] <= limit
        ]
        heapq.heapify(heads)

        released: list[Received] = []
        while heads and len(released) < room:
            name = heads[0][1]
            waiting = self._holding[name].waiting
            released.append(waiting.popleft()[1])
            if waiting and waiting[0][0] <= limit:
                heapq.heapreplace(heads, (waiting[0][0], name))
            else:
                heapq.heappop(heads)
            if not waiting:
                del self._holding[name]
        self.waiting -= len(released)
        return released

    def rewind(self, cameras: Iterable[CameraState], wall: float) -> None:
        """Compare waiting events with this machine's clock again, as it was set back.

        Those that are too far ahead now are not learned.
        """
        for camera in cameras:
            waiting = [received for _, received in camera.waiting]
            camera.waiting.clear()
            camera.reached = min(camera.reached, wall)
            self.waiting -= len(waiting)
            self.add(camera, waiting, wall)

    def _limit(self, wall: float, now: float) -> float:
        """Return the time up to which all cameras that are waited for have delivered."""
        seconds, self._looked = now - self._looked, now
        for name, camera in list(self._behind.items()):
            if not self._is_waited_for(camera, wall, now, seconds):
                del self._behind[name]
        if now < self._nothing_before:
            return -math.inf
        return min((camera.reached for camera in self._behind.values()), default=math.inf)

    def _is_waited_for(self, camera: CameraState, wall: float, now: float, seconds: float) -> bool:
        """Return True if a camera has older events to deliver, and gets on with it.

        seconds: time since this was asked last.
        """
        behind = wall - camera.reached
        held = camera.pending is not None
        if behind <= self._lateness or camera.reached < self._event_clock.newest:
            return False
        if not held and (not camera.more or now - camera.asked > SETTLE_SECONDS):
            return False

        if behind < camera.nearest - NEARER_SECONDS:
            camera.nearest = behind
            camera.stuck = 0.0
        elif not held:
            camera.stuck += seconds
        return camera.stuck <= STUCK_SECONDS_MAX
