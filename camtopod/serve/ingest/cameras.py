"""The cameras that send events: at most ``cameras_max``, as anyone can invent names.

At the limit, a new camera replaces one that has been silent for an hour. A camera whose grabber
delivers from a spool may also replace one of which events are merely published.

A camera floods if it has more events within a second than a view can show; the excess is stored as
a number and not learned.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Set

from msgspec import Struct, field

from camtopod.event_numbers import EventNumbers
from camtopod.records import CameraFigures, Event
from camtopod.serve.ingest.names import listed
from camtopod.words import OLD_SECONDS

log = logging.getLogger(__name__)

EVENTS_PER_SECOND_MAX = 200
"""Events of one camera within a second of event time; further ones are counted, not learned."""
FLOOD_SECONDS_KEPT = 128
"""Number of seconds of event time for which a camera's events are counted."""
IDLE_SECONDS = 3600.0
"""A camera that has been silent for longer can be replaced by another when there are too many."""
SAID_SECONDS = 600.0
"""How long the status mentions a camera that was refused, or that has a backlog and went away."""
BEHIND_SECONDS_MIN = 60.0
"""A camera with a backlog of which so much is still to come is named."""
REFUSED_SECONDS = 1.0
"""How long publications of new cameras are refused without a further look, after one was."""


class Pending(Struct):
    """A request that waits until its events are stored.

    boot, up_to: it is answered when the events of this boot up to this number are stored.
    reply: sends the answer.
    since: when it came, by the steady clock.
    late, refused: how many of its events are not learned, and why.
    """

    boot: str
    up_to: int
    reply: Callable[[bytes], None]
    since: float
    late: int = 0
    refused: int = 0


class Seconds:
    """The number of a camera's events by second of event time."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}

    def take(self, t: float) -> bool:
        """Count an event at ``t`` (Unix seconds); return False if it is one of a flood."""
        second = int(t)
        count = self._counts.get(second, 0)
        if count >= EVENTS_PER_SECOND_MAX:
            return False
        self._counts[second] = count + 1
        if len(self._counts) > FLOOD_SECONDS_KEPT:
            del self._counts[next(iter(self._counts))]
        return True


class CameraIntake(Struct):
    """State of one camera's intake. Times without another unit are of the steady clock.

    received: when something of the camera was last received.
    heard, heard_seconds: its events that were heard or delivered.
    spooled: True if a grabber delivers it from a spool.
    hello: the number of the grabber's last hello.
    is_new: True if it has delivered no event since.
    ahead (seconds): by how much its last event was ahead of this machine's clock.
    reached (Unix seconds): the newest event time that it has delivered.
    more: number of its events that wait in its spool.
    asked: when its last request came or was answered.
    pending: the request that waits for its answer.
    """

    name: str
    received: float
    spooled: bool = False
    hello: str = ""
    is_new: bool = False
    ahead: float | None = None
    reached: float = -math.inf
    more: int = 0
    asked: float = -math.inf
    pending: Pending | None = None
    heard: EventNumbers = field(default_factory=EventNumbers)
    heard_seconds: Seconds = field(default_factory=Seconds)

    def note_time(self, t: float, wall: float, ahead_max: float) -> bool:
        """Note an event's time (Unix seconds); return False if it is too far ahead of the clock.

        wall: this machine's time, Unix seconds.
        ahead_max: how far ahead it may be, seconds.
        """
        self.ahead = t - wall
        if self.ahead > ahead_max:
            return False
        self.reached = max(self.reached, t)
        return True


class Counted(Struct):
    """What was counted of a camera, under its present name.

    events: number of its events.
    newest (Unix seconds): event time of the newest one.
    seconds: its events by second of event time.
    """

    events: int = 0
    newest: float = -math.inf
    seconds: Seconds = field(default_factory=Seconds)


class Cameras:
    """All cameras. ``now`` is the time of a clock that never steps."""

    def __init__(self, cameras_max: int) -> None:
        self._cameras_max = cameras_max
        self._cameras: dict[str, CameraIntake] = {}
        self._tallies: dict[str, Counted] = {}
        self._refusal = ""  # the camera that was refused last
        self._refused_at = -math.inf
        self._laggards: set[str] = set()  # cameras that are behind

    def __contains__(self, name: object) -> bool:
        return name in self._cameras

    def get(self, name: str) -> CameraIntake | None:
        """Return the state of a camera; None if it is not known. Any thread."""
        return self._cameras.get(name)

    def register(self, name: str, now: float, spooled: bool = False) -> CameraIntake | None:
        """Return the state of a camera that has sent something; None if there is no room for it.

        spooled: a grabber delivers it from a spool.
        """
        camera = self._cameras.get(name)
        if camera is None:
            if len(self._cameras) >= self._cameras_max and not self._make_room(now, spooled):
                self._refusal = name
                self._refused_at = now
                return None
            camera = self._cameras[name] = CameraIntake(name, now)
        camera.received = now
        camera.spooled |= spooled
        return camera

    def count(self, event: Event) -> bool:
        """Count an event that is about to be stored; return False if its camera floods.

        An event of a flood is not counted.
        """
        if (tally := self._tallies.get(event.camera)) is None:
            tally = self._tallies[event.camera] = Counted()
        if not tally.seconds.take(event.t):
            return False
        tally.newest = max(tally.newest, event.t)
        tally.events += 1
        return True

    def forget(self, name: str) -> None:
        """Forget what was counted and heard of a camera."""
        self._tallies.pop(name, None)
        if (camera := self._cameras.get(name)) is not None:
            camera.heard, camera.heard_seconds = EventNumbers(), Seconds()

    def forget_all(self) -> None:
        """Forget what was counted."""
        self._tallies.clear()

    def rename(self, old: str, new: str) -> None:
        """Move what was counted of the camera ``old`` to the name ``new``."""
        self._tallies[new] = self._tallies.pop(old, Counted())

    def all(self) -> list[CameraIntake]:
        """Return the states of all cameras. Any thread."""
        return list(self._cameras.copy().values())

    def heard(self) -> set[str]:
        """Return the cameras of which something was heard that has a number. Any thread."""
        return {camera.name for camera in self.all() if camera.heard}

    def refused_reason(self, now: float) -> str:
        """Return which camera is refused, as there are too many, and what to do; else "".

        Any thread.
        """
        if now - self._refused_at > SAID_SECONDS or self._refusal in self._cameras:
            return ""
        return (
            f"camera {self._refusal}: refused, as limits.cameras_max ({self._cameras_max}) is"
            " reached: raise it, or stop the programs that send cameras which are not of this site;"
            " a camera that has been silent for an hour makes room"
        )

    def behind_reason(self, wall: float, now: float) -> str:
        """Return which cameras catch up, and what that means for the others; else "". Any thread.

        wall: this machine's time, Unix seconds.
        """
        behind = self._behind(wall, now)
        if not behind:
            return ""
        worst, seconds = max(behind.items(), key=lambda item: item[1])
        suffix = f", {len(behind) - 1} more less" * (len(behind) > 1)
        amount = f"{math.ceil(seconds / 60.0)} min"
        if seconds > OLD_SECONDS:
            amount = f"{seconds / OLD_SECONDS:.0f} days"
        return (
            f"camera {worst} catches up and is {amount} behind{suffix}:"
            " its events are learned as they come, and no other camera is delayed"
        )

    def log_behind(self, wall: float, now: float) -> None:
        """Log who catches up, when a camera begins to, and when all have done so."""
        behind = self._behind(wall, now).keys()
        if behind - self._laggards:
            log.warning("%s", self.behind_reason(wall, now))
        elif self._laggards and not behind:
            log.info("no camera is behind any more")
        self._laggards = self._laggards | behind if behind else set()

    def _behind(self, wall: float, now: float) -> dict[str, float]:
        """Return by how much (seconds) each camera is behind that still delivers a backlog."""
        return {
            camera.name: wall - camera.reached
            for camera in self.all()
            if camera.more
            and now - camera.asked <= SAID_SECONDS
            and BEHIND_SECONDS_MIN < wall - camera.reached < math.inf
        }

    def fast_clocks_reason(self, seconds_max: float) -> str:
        """Return which cameras' clocks are too fast for their events to be learned; else "".

        seconds_max: how far ahead of this machine's clock an event may be to be learned.

        Any thread.
        """
        names = [camera.name for camera in self.all() if (camera.ahead or 0.0) > seconds_max]
        if not names:
            return ""
        return (
            f"the clock of camera {listed(names)} is more than {seconds_max:g} s ahead of this"
            " machine's: events are stored but not learned; set that clock"
        )

    def status(
        self, alive: Set[str] = frozenset(), names: Set[str] = frozenset()
    ) -> dict[str, CameraFigures]:
        """Return the entries in the status of cameras that were counted, and of other ``names``.

        alive: those whose grabber is there.
        """
        figures = {}
        for name in sorted({*self._tallies.copy(), *names}):
            tally = self._tallies.get(name, Counted())
            camera = self.get(name)
            ahead = None if camera is None else camera.ahead
            figures[name] = CameraFigures(
                tally.events,
                tally.newest if tally.events else None,
                None if ahead is None else round(ahead, 3),
                name in alive,
            )
        return figures

    def _make_room(self, now: float, spooled: bool) -> bool:
        """Remove a camera for another; return False if none can go.

        spooled: the other camera has a grabber, so it may replace one without.
        """
        if now - self._refused_at < REFUSED_SECONDS and not spooled:
            return False
        candidates = [
            camera
            for camera in self._cameras.values()
            if camera.pending is None
            and (now - camera.received >= IDLE_SECONDS or (spooled and not camera.spooled))
        ]
        if not candidates:
            return False
        name = min(candidates, key=lambda camera: (camera.spooled, camera.received)).name
        del self._cameras[name]
        self._tallies.pop(name, None)
        return True
