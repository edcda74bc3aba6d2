"""The cameras that send events: at most ``cameras_max``, as anyone can invent names.

At the limit, a new camera replaces one that has been silent for an hour. A camera whose grabber
delivers from a spool may also replace one of which events are merely published.

A camera floods if it has more events within a second than a view can show; the excess is stored as
a number and not learned.
"""

from __future__ import annotations

import collections
import math
from collections.abc import Callable

from msgspec import Struct, field

from camtopod.records import CameraFigures, Event
from camtopod.serve.ingest.received import Received

EVENTS_PER_SECOND_MAX = 200
"""Events of one camera within a second of event time; further ones are counted, not learned."""
FLOOD_SECONDS_KEPT = 128
"""Number of seconds of event time for which a camera's events are counted."""
IDLE_SECONDS = 3600.0
"""A camera that has been silent for longer can be replaced by another when there are too many."""
SAID_SECONDS = 600.0
"""How long the status mentions a camera that two programs deliver, or that was refused."""
REFUSED_MAX = 100
"""Most refused cameras that are remembered, those refused last."""
NAMED_MAX = 3
"""Most cameras that a sentence names."""


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


class CameraState(Struct):
    """State of one camera. Times without another unit are of the steady clock.

    heard: when something of the camera was last received.
    spooled: True if a grabber delivers it from a spool.
    hello: the number of the grabber's last hello.
    doubled: when a second grabber was last seen to deliver it.
    events: number of its events.
    newest (Unix seconds): event time of the newest one.
    ahead (seconds): by how much its last event was ahead of this machine's clock.
    seconds: number of events by second of event time.
    waiting: events to be released (`merge`), each with the event time that the camera had reached.
    reached (Unix seconds): the newest event time that it has delivered.
    more: number of its events that wait in its spool.
    asked: when its last request came or was answered.
    nearest (seconds): smallest distance of ``reached`` to the clock.
    stuck (seconds): for how long that has not become smaller.
    pending: the request that waits for its answer.
    """

    name: str
    heard: float
    spooled: bool = False
    hello: str = ""
    doubled: float = -math.inf
    events: int = 0
    newest: float = 0.0
    ahead: float | None = None
    seconds: dict[int, int] = field(default_factory=dict)
    waiting: collections.deque[tuple[float, Received]] = field(default_factory=collections.deque)
    reached: float = -math.inf
    more: int = 0
    asked: float = -math.inf
    nearest: float = math.inf
    stuck: float = 0.0
    pending: Pending | None = None


class Cameras:
    """All cameras. ``now`` is the time of a clock that never steps."""

    def __init__(self, cameras_max: int) -> None:
        self._cameras_max = cameras_max
        self._cameras: dict[str, CameraState] = {}
        self._refused: dict[str, float] = {}  # when each was refused last
        self._full_until = -math.inf  # until then no camera can be replaced for its silence

    def __contains__(self, name: object) -> bool:
        return name in self._cameras

    def get(self, name: str) -> CameraState | None:
        """Return the state of a camera; None if it is not known. Any thread."""
        return self._cameras.get(name)

    def register(self, name: str, now: float, spooled: bool = False) -> CameraState | None:
        """Return the state of a camera that has sent something; None if there is no room for it.

        spooled: a grabber delivers it from a spool.
        """
        camera = self._cameras.get(name)
        if camera is None:
            if len(self._cameras) >= self._cameras_max:
                other = self._replaceable(now, spooled)
                if other is None:
                    self._refuse(name, now)
                    return None
                del self._cameras[other]
            camera = self._cameras[name] = CameraState(name, now)
        camera.heard = now
        camera.spooled |= spooled
        return camera

    def count(self, event: Event) -> bool:
        """Count an event that is about to be stored; return False if its camera floods.

        An event of a flood is not counted.
        """
        camera = self._cameras.get(event.camera)
        if camera is None:  # a renamed camera that has sent nothing under its new name
            camera = self._cameras[event.camera] = CameraState(event.camera, -math.inf)
        second = int(event.t)
        count = camera.seconds.get(second, 0)
        if count >= EVENTS_PER_SECOND_MAX:
            return False
        camera.seconds[second] = count + 1
        if len(camera.seconds) > FLOOD_SECONDS_KEPT:
            del camera.seconds[next(iter(camera.seconds))]
        if event.t > camera.newest or not camera.events:
            camera.newest = event.t
        camera.events += 1
        return True

    def forget(self, name: str) -> None:
        """Reset the counters of a camera."""
        if (camera := self._cameras.get(name)) is not None:
            camera.events = 0
            camera.newest = 0.0
            camera.seconds.clear()

    def forget_all(self) -> None:
        """Reset the counters of all cameras."""
        for name in self._cameras:
            self.forget(name)

    def rename(self, old: str, new: str) -> None:
        """Move the counters of the camera ``old`` to the name ``new``."""
        if (known := self._cameras.get(old)) is None:
            return
        camera = self._cameras.setdefault(new, CameraState(new, known.heard))
        camera.events = known.events
        camera.newest = known.newest
        camera.seconds = dict(known.seconds)
        self.forget(old)

    def all(self) -> list[CameraState]:
        """Return the states of all cameras. Any thread."""
        return list(self._cameras.copy().values())

    def refused_reason(self, now: float) -> str:
        """Return which cameras are refused, as there are too many, and what to do; else "".

        Any thread.
        """
        recently = now - SAID_SECONDS
        refused = [name for name, at in self._refused.copy().items() if at >= recently]
        refused = [name for name in refused if name not in self._cameras]
        if not refused:
            return ""
        fewest = sorted(self.all(), key=lambda one: (one.spooled, one.events, one.name))
        named = ", ".join(f"{one.name} ({one.events})" for one in fewest[:NAMED_MAX])
        return (
            f"{in_words(refused[::-1])}: refused, as limits.cameras_max ({self._cameras_max}) is"
            f" reached; the cameras with the fewest events are {named}: if they are not of this"
            " site, stop the program that sends them, and they are replaced within an hour;"
            " otherwise raise limits.cameras_max"
        )

    def doubled_reason(self, now: float) -> str:
        """Return which cameras two grabbers deliver, and what to do; else "". Any thread."""
        names = [one.name for one in self.all() if now - one.doubled <= SAID_SECONDS]
        what = "two programs at the same time publish"
        return f"{what} {in_words(names)}: give one of the cameras another id" if names else ""

    def fast_clocks_reason(self, seconds_max: float) -> str:
        """Return which cameras' clocks are too fast for their events to be learned; else "".

        seconds_max: how far ahead of this machine's clock an event may be to be learned.

        Any thread.
        """
        names = [one.name for one in self.all() if (one.ahead or 0.0) > seconds_max]
        if not names:
            return ""
        return (
            f"the clock of {in_words(names)} is more than {seconds_max:g} s ahead of this"
            " machine's: events are stored but not learned; set that clock"
        )

    def status(self, alive: set[str]) -> dict[str, CameraFigures]:
        """Return each camera's entry in the status; ``alive``: those whose grabber is there."""
        return {
            one.name: CameraFigures(
                one.events,
                one.newest,
                None if one.ahead is None else round(one.ahead, 3),
                one.name in alive,
            )
            for one in sorted(self.all(), key=lambda one: one.name)
            if one.events
        }

    def _replaceable(self, now: float, spooled: bool) -> str | None:
        """Return the camera to be replaced by another; None if there is none.

        spooled: the other camera has a grabber, so it may replace one without.
        """
        if now < self._full_until and not spooled:
            return None
        others = [
            one
            for one in self._cameras.values()
            if not one.waiting
            and one.pending is None
            and (now - one.heard >= IDLE_SECONDS or (spooled and not one.spooled))
        ]
        if not others:
            self._full_until = min(one.heard for one in self._cameras.values()) + IDLE_SECONDS
            return None
        return min(others, key=lambda one: (one.spooled, one.events, one.heard, one.name)).name

    def _refuse(self, name: str, now: float) -> None:
        """Remember that a camera was refused."""
        self._refused.pop(name, None)  # the one refused last comes last
        self._refused[name] = now
        if len(self._refused) > REFUSED_MAX:
            del self._refused[next(iter(self._refused))]


def in_words(names: list[str]) -> str:
    """Return for example ``camera a``, or ``cameras a, b, c and 4 others``."""
    if len(names) == 1:
        return f"camera {names[0]}"
    others = len(names) - NAMED_MAX
    listed = ", ".join(names[:NAMED_MAX])
    return f"cameras {listed} and {others} others" if others > 0 else f"cameras {listed}"
