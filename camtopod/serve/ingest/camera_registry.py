"""Keep track of each camera that sends events, and decide which of its events to trust.

Clocks are not trusted. An event stamped far ahead of this machine's clock is stored, but not
learned. Learning one stamped a little ahead would make other cameras' events late, as event time
follows the newest events; so this event, and those that its camera sends after it, wait until their
time has come: a fast clock delays only its own camera.

This machine's clock may be slow. Cameras are trusted against it as far as it is known to be slow:
by how much it was set back, or how far it is before the time at which the newest entries were
stored. Beyond that several boxes have to agree, with one vote each, as the cameras of a box share
its clock. When this machine's clock is set forward, so are the clocks of cameras on this machine,
and event time would follow; so the step is trusted only after it has lasted, or at once as far as
cameras were ahead already. If event time is ahead all the same, it is taken back.

A camera floods if it has more events within a second than a view can show; the excess is not
learned.

Names can be invented, so the number of cameras is limited. At the limit, a new camera replaces one
that has been silent for an hour. A camera whose grabber has been seen alive may also replace one
that merely sends events.
"""

from __future__ import annotations

import collections
import logging
import math
import statistics
import threading
from collections.abc import Mapping, Set

from msgspec import Struct, field, structs

from camtopod.admin import Command
from camtopod.config import Limits
from camtopod.publishers import Publisher
from camtopod.records import CameraFigures, Event
from camtopod.serve.storage import Entry, Rewind

log = logging.getLogger(__name__)

EARLY_SECONDS_MAX = 1.0
"""An event up to this much ahead of the clock need not wait, in seconds.

It is far below the lateness that the learner allows for.
"""
VOTES_MIN = 3
"""Number of recently active boxes that have to agree before this machine's clock is taken for slow.

Fewer are enough as far as it is known to be slow.
"""
LEADS_SECONDS = 60.0
"""A box is recently active if an event came from it within this time."""
LOOK_SECONDS = 1.0
"""Interval of checks whether this machine's clock is slow."""
STEP_SECONDS_MIN = 5.0
"""Smallest change against the steady clock that counts as a step of this machine's clock."""
TRUSTED_SECONDS = 600.0
"""Time that a step forward has to last, by the steady clock, until it is trusted."""
REWIND_SECONDS = 10.0
"""Event time that has been ahead for this long is taken back.

If this machine's clock was set back it is `TRUSTED_SECONDS`, as that step may have been wrong.
"""
DOUBLED_SECONDS = 600.0
"""How long the status mentions a camera that two programs were seen to publish."""
FLOOD_SECONDS_KEPT = 128
"""Number of seconds of event time for which a camera's events are counted."""
IDLE_SECONDS = 3600.0
"""A camera that has been silent for longer can be replaced by another when there are too many."""
REFUSED_SECONDS = 60.0
"""How long the status mentions a refused camera after its last event."""
REFUSED_MAX = 100
"""Most refused cameras that are remembered, those refused last."""
NAMED_MAX = 3
"""Most cameras that a sentence names."""


class Received(Struct, frozen=True, gc=False):
    """An entry on its way into the journal, and its effect on the learner.

    event: the event to be learned; None if it is only stored.
    advance, rewind: a change of event time.
    command: an operator's command.
    names: with a command, the state of all names after it, as it is stored (`Names`).
    stored: set when the entry is stored, if somebody waits for that.
    """

    entry: Entry
    event: Event | None = None
    advance: float | None = None
    rewind: Rewind | None = None
    command: Command | None = None
    names: str | None = None
    stored: threading.Event | None = None


class CameraState(Struct):
    """State of one camera; ``heard`` and ``doubled`` are times of the steady clock.

    heard: when something of the camera was last received.
    lead (seconds): by how much its last published event was ahead of this machine's clock; events
        out of spools do not count.
    lead_at: when that was, by the steady clock.
    box: the box whose clock it uses; "" if unknown.
    publisher: the boots of its published events.
    doubled: when two programs were last seen to publish it at the same time.
    events, newest: number of its events, and the newest event time.
    seconds: number of events by second of event time.
    waiting: events that wait, each with the time when it is due by the steady clock.
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


class CameraRegistry:
    """All cameras, at most ``limits.cameras_max``.

    In all methods ``now`` is the time of a clock that never steps, and ``wall`` is this machine's
    time, in seconds since 1970.

    behind (seconds): by how much this machine's clock is known to be slow at the start.
    boxes: certificate under which each camera is published, where there are certificates.
    """

    def __init__(
        self, limits: Limits, behind: float = 0.0, boxes: Mapping[str, str] | None = None
    ) -> None:
        self.limits = limits
        self._boxes = boxes or {}
        self._cameras: dict[str, CameraState] = {}
        self._waiting: set[str] = set()
        self._refused: dict[str, float] = {}  # when each was refused last
        self._full_until = -math.inf  # until then no camera can be replaced for its silence
        self._next_look = 0.0
        self._beside: float | None = None  # this machine's clock minus the steady one
        self._noticed = -math.inf  # when that was checked last
        self._set_back = max(0.0, behind)
        # Steps forward that are not trusted yet: (when, seconds), oldest first.
        self._doubted: list[tuple[float, float]] = []
        self._restored = -math.inf  # when a step forward was last undone
        self._ahead_since: float | None = None  # since when event time has been ahead
        self.clock_ahead = 0.0
        """Seconds by which this machine's clock was set forward that are not trusted yet."""
        self.clock_behind = 0.0
        """Seconds to add to this machine's clock: by how much it is slow, less `clock_ahead`."""

    def __contains__(self, name: object) -> bool:
        return name in self._cameras

    def register(self, name: str, now: float, with_publisher: Set[str] = frozenset()) -> bool:
        """Register a camera that has sent something; return False if there is no room for it.

        with_publisher: cameras whose publisher has been seen alive.
        """
        if name not in self._cameras and len(self._cameras) >= self.limits.cameras_max:
            other = self._find_replaceable(now, with_publisher, name in with_publisher)
            if other is None:
                self._refused.pop(name, None)  # the one refused last comes last
                self._refused[name] = now
                if len(self._refused) > REFUSED_MAX:
                    del self._refused[next(iter(self._refused))]
                return False
            del self._cameras[other]
        (self._cameras.get(name) or self._state_of(name)).heard = now
        return True

    def _find_replaceable(
        self, now: float, with_publisher: Set[str], preferred: bool
    ) -> str | None:
        """Return the camera to be replaced by another; None if there is none.

        preferred: the other camera has a publisher, so it may replace one without.
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

    def refused_reason(self, now: float, with_publisher: Set[str] = frozenset()) -> str:
        """Return which cameras are refused, as there are too many, and what to do; else "".

        Any thread.
        """
        # Cameras refused recently.
        cameras, lately = self._cameras.copy(), now - REFUSED_SECONDS
        refused = [
            name
            for name, at in self._refused.copy().items()
            if at >= lately and name not in cameras
        ]
        if not refused:
            return ""

        # Describe them, and the cameras with the fewest events.
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
            f"{who} refused, as limits.cameras_max ({most}) is reached; the cameras with the fewest"
            f" events are {named}: if they are not of this site, stop the program that sends them,"
            " and they are replaced within an hour; otherwise raise limits.cameras_max"
        )

    def is_future(self, event: Event, wall: float, now: float, fresh: bool, box: str = "") -> bool:
        """Return True if an event that arrives now is too far ahead to be true.

        fresh: it was published, and does not come out of a spool.
        box: the box whose clock has stamped it, as its publisher says.
        """
        self._notice_step(wall - now, now)

        # A published event tells about the clock and the publisher of its camera.
        if fresh:
            camera = self._cameras.get(event.camera) or self._state_of(event.camera)
            camera.lead, camera.lead_at = event.t - wall, now
            camera.box = self._boxes.get(event.camera, box)
            if event.boot is not None and camera.publisher.note_boot(event.boot):
                camera.doubled = now

        # Check this machine's clock from time to time.
        if now >= self._next_look:
            self._next_look = now + LOOK_SECONDS
            self._check_clock(now)
        return event.t - wall > self.clock_behind + self.limits.future_seconds_max

    def count_event(self, event: Event) -> bool:
        """Count an event that is about to be stored; return False if its camera floods.

        An event of a flood is not counted.
        """
        camera = self._cameras.get(event.camera) or self._state_of(event.camera)
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

    def forget(self, name: str) -> None:
        """Reset the counters of a camera; its waiting events are kept."""
        if (known := self._cameras.get(name)) is not None:
            self._cameras[name] = CameraState(known.heard, waiting=known.waiting)

    def forget_all(self) -> None:
        """Reset the counters of all cameras."""
        for name in self._cameras.copy():
            self.forget(name)

    def rename(self, old: str, new: str) -> None:
        """Move the counters of the camera ``old`` to the name ``new``."""
        if (known := self._cameras.get(old)) is not None:
            waiting = self._state_of(new).waiting
            self._cameras[new] = structs.replace(known, waiting=waiting)
            self.forget(old)

    def is_full(self, name: str) -> bool:
        """Return True if no more events of this camera can wait for their time."""
        return (
            name in self._waiting
            and len(self._state_of(name).waiting) >= self.limits.held_events_max
        )

    def release_due(self, ready: list[Received], wall: float, now: float) -> list[Received]:
        """Return the events whose time has come, of these and of those that wait.

        Events of one camera stay in order.
        """
        self._notice_step(wall - now, now)
        due = [received for name in sorted(self._waiting) for received in self._due(name, now)]
        wall += self.clock_behind
        for received in ready:
            name, event = received.entry.camera, received.event
            early = 0.0 if event is None else event.t - wall - EARLY_SECONDS_MAX
            if early > 0.0 or name in self._waiting:
                self._state_of(name).waiting.append((now + early, received))
                self._waiting.add(name)
            else:
                due.append(received)
        return due

    @property
    def waiting(self) -> int:
        """Number of events that wait for their time."""
        cameras = self._cameras.copy()
        return sum(len(cameras[name].waiting) for name in self._waiting.copy() if name in cameras)

    def status(self) -> dict[str, CameraFigures]:
        """Return each camera's entry in the status. Any thread.

        ``ahead`` is by how much the camera is ahead of this machine's clock, in seconds; None if
        unknown.
        """
        return {
            name: CameraFigures(
                events=one.events,
                newest=one.newest,
                ahead=None if one.lead_at == -math.inf else round(one.lead, 3),
            )
            for name, one in self._cameras.copy().items()
            if one.events
        }

    def clock_reason(self, watermark: float, wall: float) -> str:
        """Return why events are not learned because of clocks, and what to do; else "". Any thread.

        watermark (Unix seconds): the learner's; older events are not learned.
        """
        if self.clock_ahead > self.limits.future_seconds_max:
            return (
                f"this machine's clock was set forward by {self.clock_ahead:.0f} s: events stamped"
                f" by such a clock are stored but not learned until the clock has stayed so for"
                f" {TRUSTED_SECONDS:g} s; if it is right now, restart the daemon, which then"
                " trusts it at once"
            )
        ahead = watermark - wall - self.clock_behind
        if ahead > self.limits.future_seconds_max:
            return (
                f"event time is {ahead:.0f} s ahead of this machine's clock, so events are late:"
                f" they are stored but not learned; if that lasts for {self._rewind_seconds:g} s,"
                " the events ahead are dropped and event time continues from this machine's clock;"
                " if that clock is wrong, set it"
            )
        return ""

    def fast_clocks_reason(self, now: float) -> str:
        """Return which cameras' clocks are too fast for their events to be learned, by box.

        "" if none are. Any thread.
        """
        boxes: dict[tuple[str, float], list[str]] = {}
        for name, camera in sorted(self._cameras.copy().items()):
            ahead = camera.lead - self.clock_behind
            if ahead > self.limits.future_seconds_max and now - camera.lead_at <= LEADS_SECONDS:
                boxes.setdefault((camera.box, round(ahead, -1)), []).append(name)
        return "; ".join(
            f"the clock of {_in_words(names)}{f' (one box: {box})' if box else ''} is about"
            f" {ahead:.0f} s ahead of this machine's: events are stored but not learned; set that"
            " clock"
            for (box, ahead), names in boxes.items()
        )

    def double_publishers_reason(self, now: float) -> str:
        """Return which cameras two programs publish at the same time, and what to do; else "".

        Any thread.
        """
        names = [
            name
            for name, one in sorted(self._cameras.copy().items())
            if now - one.doubled <= DOUBLED_SECONDS
        ]
        what = "two programs at the same time publish"
        return f"{what} {_in_words(names)}: give one of the cameras another id" if names else ""

    def rewind_to(self, watermark: float | None, wall: float, now: float) -> float | None:
        """Return the time (Unix seconds) to which to take event time back now; None if not now.

        That is when event time has been ahead of this machine's clock and of the cameras for long
        enough.
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
        return TRUSTED_SECONDS if self._set_back > 0.0 else REWIND_SECONDS

    def _state_of(self, name: str) -> CameraState:
        """Return the state of a camera.

        It is made anew if the camera was replaced while one of its events was still under way.
        """
        camera = self._cameras.get(name)
        if camera is None:
            camera = self._cameras[name] = CameraState(-math.inf)
        return camera

    def _leads(self, now: float) -> list[float]:
        """Return the lead of each recently active box: the median of its cameras.

        All cameras of unknown boxes count as one box.
        """
        boxes: dict[str, list[float]] = {}
        for camera in self._cameras.values():
            if now - camera.lead_at <= LEADS_SECONDS:
                boxes.setdefault(camera.box, []).append(camera.lead)
        return [statistics.median_low(leads) for leads in boxes.values()]

    def _check_clock(self, now: float) -> None:
        """Check whether this machine's clock is slow.

        Events stamped by a clock whose step was undone do not count.
        """
        leads = self._leads(now)
        behind = max(0.0, statistics.median_low(leads)) if leads else 0.0
        if len(leads) < VOTES_MIN or now - self._restored <= LEADS_SECONDS:
            behind = min(behind, self._set_back)
        self.clock_behind = behind - self.clock_ahead

    def _notice_step(self, beside: float, now: float) -> None:
        """Notice a step of this machine's clock.

        beside (seconds): this machine's clock minus the steady one, now.
        """
        if now == self._noticed and beside == self._beside:
            return

        # Has the clock stepped?
        step = beside - (beside if self._beside is None else self._beside)
        self._beside, self._noticed = beside, now
        if step >= STEP_SECONDS_MIN:
            self._go_forward(step, now)
        elif step <= -STEP_SECONDS_MIN:
            self._go_back(-step, now)

        # Trust steps forward that have lasted.
        lasted = [seconds for since, seconds in self._doubted if now - since >= TRUSTED_SECONDS]
        if lasted:
            del self._doubted[: len(lasted)]
            log.warning(
                "this machine's clock, set forward by %.0f s, has stayed so: it is trusted now",
                sum(lasted),
            )

        # After a change, correct the leads and check the clock again.
        if lasted or abs(step) >= STEP_SECONDS_MIN:
            self.clock_ahead = sum(seconds for _, seconds in self._doubted)
            for camera in self._cameras.values():
                camera.lead -= step
            self._next_look = -math.inf
            self._check_clock(now)

    def _go_forward(self, step: float, now: float) -> None:
        """Note a step forward, trusted as far as it undoes a step back or cameras were ahead."""
        leads = self._leads(now)
        doubted = step - max(self._set_back, statistics.median_low(leads) if leads else 0.0)
        self._set_back = max(0.0, self._set_back - step)
        if doubted >= STEP_SECONDS_MIN:
            self._doubted.append((now, doubted))
            log.warning(
                "this machine's clock was set forward by %.0f s: it is trusted after %g s without"
                " another jump",
                doubted,
                TRUSTED_SECONDS,
            )

    def _go_back(self, step: float, now: float) -> None:
        """Note a step back; it first undoes steps forward that were not trusted yet."""
        while self._doubted and step > 0.0:
            since, doubted = self._doubted.pop()
            self._restored = now
            if doubted - step >= STEP_SECONDS_MIN:
                self._doubted.append((since, doubted - step))
            step = max(0.0, step - doubted)
        self._set_back += step

    def _due(self, name: str, now: float) -> list[Received]:
        """Return a camera's waiting events whose time has come."""
        waiting = self._cameras[name].waiting
        due = []
        while waiting and waiting[0][0] <= now:
            due.append(waiting.popleft()[1])
        if not waiting:
            self._waiting.discard(name)
        return due


def _in_words(names: list[str]) -> str:
    """Return names as in ``cameras a, b and 3 more``."""
    more = f" and {len(names) - NAMED_MAX} more" if len(names) > NAMED_MAX else ""
    return f"{'cameras' if len(names) > 1 else 'camera'} {', '.join(names[:NAMED_MAX])}{more}"
