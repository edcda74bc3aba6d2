"""What is known of each camera that sends, and which of its events are to be believed.

Clocks are not trusted. An event stamped far ahead of this machine's clock is set aside. One stamped
a little ahead would make everybody else's late, as the learner's time is that of the newest event;
so it, and what its camera sends after it, waits here until its time has come: a wild camera delays
itself.

Cameras are taken at their word against this machine's clock as far as it is known to be behind: by
how much it was set back, or is before the moment at which the newest entries were stored. Beyond
that several boxes have to agree, each with one vote however many cameras it has, as the cameras of
a box share its clock. When this machine's clock is set forward, so are the clocks of cameras on
this machine, and event time would go with them: so that counts when it has lasted, or at once as
far as cameras were ahead already. Where event time is ahead all the same it is taken back.

A camera that has more events within a second than any view can show floods; what is too much is not
learned.

Names can be invented, so places are limited. When all are taken, one that has been silent for an
hour is given away, and to a camera whose grabber has been seen alive that of one that merely sends.
"""

from __future__ import annotations

import collections
import logging
import math
import statistics
from collections.abc import Mapping, Set
from typing import Any

from msgspec import Struct, field

from camtopod.config import Limits
from camtopod.publishers import Publisher
from camtopod.records import Event
from camtopod.serve.storage import Entry, Rewind

log = logging.getLogger(__name__)

EARLY_SECONDS_MAX = 1.0
"""An event this far ahead of the clock is taken at once; far below the lateness that the learner
allows for.
"""
VOTES_MIN = 3
"""Boxes heard lately that have to agree before this machine's clock is doubted beyond what is known
of it.
"""
LEADS_SECONDS = 60.0
"""Heard lately."""
LOOK_SECONDS = 1.0
"""How often it is asked again whether this machine's clock is behind."""
STEP_SECONDS_MIN = 5.0
"""This machine's clock is set when it moves so much against the one that does not step."""
BELIEVED_SECONDS = 600.0
"""A clock that was set forward is believed when it has stayed so for this long, by the one that
does not step.
"""
REWIND_SECONDS = 10.0
"""Event time that has been ahead for so long is taken back; when this machine's clock was set back
it has to have been for `BELIEVED_SECONDS`, as that may have been the mistake."""
DOUBLED_SECONDS = 600.0
"""How long the status mentions a camera after two programs were seen to publish it."""
FLOOD_SECONDS_KEPT = 128
"""Seconds of event time in which a camera's events are counted."""
IDLE_SECONDS = 3600.0
"""When there are too many cameras, one silent for longer gives its place to another."""
REFUSED_SECONDS = 60.0
"""It is said that a camera is refused for so long after its last event, ..."""
REFUSED_MAX = 100
"""... and of so many cameras, those refused last."""
NAMED_MAX = 3
"""Cameras that are named in a sentence."""


class Received(Struct, frozen=True, gc=False):
    """On its way into the journal: an event (none if it is not to be learned), an advance of event
    time, a rewind.
    """

    entry: Entry
    event: Event | None = None
    advance: float | None = None
    rewind: Rewind | None = None


class Camera(Struct):
    """``heard``: when something of it came last (steady). ``lead``: seconds by which what came
    fresh from it was ahead of this machine's clock, and ``lead_at``: when that was; ``box``: whose
    clock it has, "" if that is not known. ``publisher``: whose events come fresh; ``doubled``: when
    two were last seen to publish at the same time (steady).
    """

    heard: float
    lead: float = 0.0
    lead_at: float = -math.inf
    box: str = ""
    publisher: Publisher = field(default_factory=lambda: Publisher(""))
    doubled: float = -math.inf
    events: int = 0
    newest: float = 0.0
    seconds: dict[int, int] = field(default_factory=dict)
    waiting: collections.deque[tuple[float, Received]] = field(default_factory=collections.deque)


class Cameras:
    """At most ``limits.cameras_max``. ``now`` is always of a clock that never steps, ``wall`` is
    seconds since 1970.

    ``behind``: seconds by which this machine's clock is known to be behind from the beginning.
    ``boxes``: by camera the certificate under which it is published, where there are certificates.
    """

    def __init__(
        self, limits: Limits, behind: float = 0.0, boxes: Mapping[str, str] | None = None
    ) -> None:
        self.limits = limits
        self._boxes = boxes or {}
        self._cameras: dict[str, Camera] = {}
        self._waiting: set[str] = set()
        self._refused: dict[str, float] = {}  # when each was refused last
        self._full_until = -math.inf  # until then no camera will have been silent for long
        self._next_look = 0.0
        self._beside: float | None = None  # this machine's clock less the one that does not step
        self._noticed = -math.inf  # when that was looked at last
        self._set_back = max(0.0, behind)
        self._doubted: list[
            tuple[float, float]
        ] = []  # when it was set forward, and by how much; oldest first
        self._restored = -math.inf  # when that was last undone
        self._ahead_since: float | None = None  # event time, of this machine's clock (steady)
        self.clock_ahead = 0.0
        """Seconds by which this machine's clock has been set forward that are not believed yet."""
        self.clock_behind = 0.0
        """Seconds by which most cameras are ahead of this machine's clock, less those that are not
        believed.
        """

    def __contains__(self, name: object) -> bool:
        return name in self._cameras

    def admit(self, name: str, now: float, with_publisher: Set[str] = frozenset()) -> bool:
        """Whether there is room for this camera, of which something came; it has a place from now
        on.

        ``with_publisher``: cameras whose publisher has been seen alive.
        """
        if name not in self._cameras and len(self._cameras) >= self.limits.cameras_max:
            other = self._gives_way(now, with_publisher, name in with_publisher)
            if other is None:
                self._refused.pop(name, None)  # the one refused last comes last
                self._refused[name] = now
                if len(self._refused) > REFUSED_MAX:
                    del self._refused[next(iter(self._refused))]
                return False
            del self._cameras[other]
        (self._cameras.get(name) or self._place(name)).heard = now
        return True

    def _gives_way(self, now: float, with_publisher: Set[str], preferred: bool) -> str | None:
        """The camera whose place may be given to another, to one without a publisher unless that is
        ``preferred``.
        """
        if now < self._full_until and not preferred:
            return None
        may = [
            (name in with_publisher, one.events, one.heard, name)
            for name, one in self._cameras.items()
            if now - one.heard >= IDLE_SECONDS or (preferred and name not in with_publisher)
        ]
        may = [row for row in may if row[-1] not in self._waiting]
        if not may:
            self._full_until = min(one.heard for one in self._cameras.values()) + IDLE_SECONDS
            return None
        return min(may)[-1]

    def crowded(self, now: float, with_publisher: Set[str] = frozenset()) -> str:
        """Which cameras are refused as there are too many, and what to do; "" if none is. Any
        thread.
        """
        cameras, lately = self._cameras.copy(), now - REFUSED_SECONDS
        refused = [
            name
            for name, at in self._refused.copy().items()
            if at >= lately and name not in cameras
        ]
        if not refused:
            return ""
        who, others = f"camera {refused[-1]} is", len(refused) - 1
        if others:
            least = "at least " if len(refused) == REFUSED_MAX else ""
            who = f"camera {refused[-1]} and {least}{others} other{'s' * (others > 1)} are"
        fewest = sorted(
            cameras, key=lambda name: (name in with_publisher, cameras[name].events, name)
        )[:NAMED_MAX]
        named, most = (
            ", ".join(f"{name} ({cameras[name].events})" for name in fewest),
            self.limits.cameras_max,
        )
        return (
            f"{who} refused, as limits.cameras_max ({most}) is reached; the fewest events are those of {named}: if "
            "they are no cameras of this site, stop what sends them, and their places are free within an hour; "
            "otherwise raise limits.cameras_max"
        )

    def is_future(self, event: Event, wall: float, now: float, fresh: bool, box: str = "") -> bool:
        """Whether an event that arrives now (``fresh`` from the camera, or out of a spool) is too
        far ahead to be true. ``box``: whose clock has stamped it, as its publisher says.
        """
        self._notice_step(wall - now, now)
        if fresh:
            camera = self._cameras.get(event.camera) or self._place(event.camera)
            camera.lead, camera.lead_at = event.t - wall, now
            camera.box = self._boxes.get(event.camera, box)
            if event.boot is not None and camera.publisher.note(event.boot):
                camera.doubled = now
        if now >= self._next_look:
            self._next_look = now + LOOK_SECONDS
            self._look(now)
        return event.t - wall > self.clock_behind + self.limits.future_seconds_max

    def note(self, event: Event) -> bool:
        """It is about to be stored; False if its camera has had too many events in this second, for
        it to count too.
        """
        camera = self._cameras.get(event.camera) or self._place(event.camera)
        t, seconds = event.t, camera.seconds
        second = int(t)
        count = seconds.get(second, 0)
        if count >= self.limits.camera_events_per_second_max:
            return False
        seconds[second] = count + 1
        if len(seconds) > FLOOD_SECONDS_KEPT:
            del seconds[next(iter(seconds))]
        if t > camera.newest or not camera.events:
            camera.newest = t
        camera.events += 1
        return True

    def full(self, name: str) -> bool:
        """Whether no more of this camera's events can wait for their time."""
        return (
            name in self._waiting and len(self._place(name).waiting) >= self.limits.held_events_max
        )

    def in_time(self, ready: list[Received], wall: float, now: float) -> list[Received]:
        """Those whose time has come, of these and of what waits; in order for each camera."""
        self._notice_step(wall - now, now)
        due = [received for name in sorted(self._waiting) for received in self._due(name, now)]
        wall += self.clock_behind
        for received in ready:
            name, event = received.entry.camera, received.event
            early = 0.0 if event is None else event.t - wall - EARLY_SECONDS_MAX
            if early > 0.0 or name in self._waiting:
                self._place(name).waiting.append((now + early, received))
                self._waiting.add(name)
            else:
                due.append(received)
        return due

    @property
    def waiting(self) -> int:
        """Events that wait for their time."""
        cameras = self._cameras.copy()
        return sum(len(cameras[name].waiting) for name in self._waiting.copy() if name in cameras)

    def status(self) -> dict[str, dict[str, Any]]:
        """For each camera what the status says; ``ahead``: of this machine's clock, in seconds, or
        None. Any thread.
        """
        return {
            name: {
                "events": one.events,
                "newest": one.newest,
                "ahead": None if one.lead_at == -math.inf else round(one.lead, 3),
            }
            for name, one in self._cameras.copy().items()
            if one.events
        }

    def reason(self, watermark: float, wall: float) -> str:
        """Why what comes is not learned, and what to do; "" if it is. ``watermark``: nothing older
        is. Any thread.
        """
        if self.clock_ahead > self.limits.future_seconds_max:
            return (
                f"this machine's clock was set forward by {self.clock_ahead:.0f} s: events of that time are set aside, "
                f"not learned, until it has stayed so for {BELIEVED_SECONDS:g} s; if it is right now, a restart of the "
                "daemon believes it at once"
            )
        ahead = watermark - wall - self.clock_behind
        if ahead > self.limits.future_seconds_max:
            return (
                f"event time is {ahead:.0f} s ahead of this machine's clock, so events are late, stored and not "
                f"learned; if that lasts for {self._rewind_seconds:g} s, what lies ahead is dropped and event time "
                "goes on from this machine's clock; if that clock is wrong, set it"
            )
        return ""

    def wild(self, now: float) -> str:
        """Which cameras have clocks so far ahead that their events are set aside, by box; "" if
        there are none. Any thread.
        """
        boxes: dict[tuple[str, float], list[str]] = {}
        for name, camera in sorted(self._cameras.copy().items()):
            ahead = camera.lead - self.clock_behind
            if ahead > self.limits.future_seconds_max and now - camera.lead_at <= LEADS_SECONDS:
                boxes.setdefault((camera.box, round(ahead, -1)), []).append(name)
        return "; ".join(
            f"the clock of {_in_words(names)}{f' (one box: {box})' if box else ''} is about {ahead:.0f} s ahead of "
            "this machine's: events are set aside, not learned; set that clock"
            for (box, ahead), names in boxes.items()
        )

    def doubled(self, now: float) -> str:
        """Which cameras two programs publish at the same time; "" if none are. Any thread."""
        names = [
            name
            for name, one in sorted(self._cameras.copy().items())
            if now - one.doubled <= DOUBLED_SECONDS
        ]
        what = "two programs at the same time publish"
        return f"{what} {_in_words(names)}: give what one of them sees another id" if names else ""

    def rewind_to(self, watermark: float | None, wall: float, now: float) -> float | None:
        """To which moment (Unix seconds) event time is to be taken back now, as it has been ahead
        of what this machine's clock and the cameras say for long enough; None: not now.
        """
        right = wall + self.clock_behind
        doubtful = self.clock_ahead > 0.0 or (self._set_back > 0.0 and not self._leads(now))
        if watermark is None or doubtful or watermark - right <= self.limits.future_seconds_max:
            self._ahead_since = None
            return None
        if self._ahead_since is None:
            self._ahead_since = now
        if now - self._ahead_since < self._rewind_seconds:
            return None
        self._ahead_since = None
        return right

    @property
    def _rewind_seconds(self) -> float:
        return BELIEVED_SECONDS if self._set_back > 0.0 else REWIND_SECONDS

    def _place(self, name: str) -> Camera:
        """A camera's; made anew if it was given away while something of the camera was still under
        way.
        """
        camera = self._cameras.get(name)
        if camera is None:
            camera = self._cameras[name] = Camera(-math.inf)
        return camera

    def _leads(self, now: float) -> list[float]:
        """Of the boxes heard lately, each the median of its cameras; the cameras of unknown boxes
        are taken for one.
        """
        boxes: dict[str, list[float]] = {}
        for camera in self._cameras.values():
            if now - camera.lead_at <= LEADS_SECONDS:
                boxes.setdefault(camera.box, []).append(camera.lead)
        return [statistics.median_low(leads) for leads in boxes.values()]

    def _look(self, now: float) -> None:
        """Whether this machine's clock is behind. What was stamped by the wrong clock is no
        witness.
        """
        leads = self._leads(now)
        behind = max(0.0, statistics.median_low(leads)) if leads else 0.0
        if len(leads) < VOTES_MIN or now - self._restored <= LEADS_SECONDS:
            behind = min(behind, self._set_back)
        self.clock_behind = behind - self.clock_ahead

    def _notice_step(self, beside: float, now: float) -> None:
        """This machine's clock may have been set; ``beside``: it less the one that does not step,
        now.
        """
        if now == self._noticed and beside == self._beside:
            return
        step = beside - (beside if self._beside is None else self._beside)
        self._beside, self._noticed = beside, now
        if step >= STEP_SECONDS_MIN:
            self._go_forward(step, now)
        elif step <= -STEP_SECONDS_MIN:
            self._go_back(-step, now)
        lasted = [seconds for since, seconds in self._doubted if now - since >= BELIEVED_SECONDS]
        if lasted:
            del self._doubted[: len(lasted)]
            log.warning(
                "this machine's clock has stayed %.0f s further on: it is believed now", sum(lasted)
            )
        if lasted or abs(step) >= STEP_SECONDS_MIN:
            self.clock_ahead = sum(seconds for _, seconds in self._doubted)
            for camera in self._cameras.values():
                camera.lead -= step
            self._next_look = -math.inf
            self._look(now)

    def _go_forward(self, step: float, now: float) -> None:
        leads = self._leads(now)
        doubted = step - max(self._set_back, statistics.median_low(leads) if leads else 0.0)
        self._set_back = max(0.0, self._set_back - step)
        if doubted >= STEP_SECONDS_MIN:
            self._doubted.append((now, doubted))
            log.warning(
                "this machine's clock was set forward by %.0f s: it is believed when it has stayed so for %g s",
                doubted,
                BELIEVED_SECONDS,
            )

    def _go_back(self, step: float, now: float) -> None:
        while self._doubted and step > 0.0:
            since, doubted = self._doubted.pop()
            self._restored = now
            if doubted - step >= STEP_SECONDS_MIN:
                self._doubted.append((since, doubted - step))
            step = max(0.0, step - doubted)
        self._set_back += step

    def _due(self, name: str, now: float) -> list[Received]:
        waiting = self._cameras[name].waiting
        due = []
        while waiting and waiting[0][0] <= now:
            due.append(waiting.popleft()[1])
        if not waiting:
            self._waiting.discard(name)
        return due


def _in_words(names: list[str]) -> str:
    """For example ``cameras a, b and 3 more``."""
    more = f" and {len(names) - NAMED_MAX} more" if len(names) > NAMED_MAX else ""
    return f"{'cameras' if len(names) > 1 else 'camera'} {', '.join(names[:NAMED_MAX])}{more}"
