"""Reorder buffer with a watermark: the learner gets events ordered by time.

An event at or above the watermark is held until the watermark has passed it. An event below it is
late: it is counted, but not learned. So the output does not depend on the order in which events are
received, as long as none is later than the lateness allows. `camtopod.event_time` defines event
time and watermark. An event with the same (camera, boot, seq) as an earlier one is a duplicate and
counts once.

Memory is limited: for each camera and tick of event time, only the newest events count, up to a
rate (`EVENTS_PER_SECOND_MAX`) that no real view reaches. These do not depend on the order in which
events are received either.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Set
from operator import itemgetter

from msgspec import Struct

from camtopod.event_time import CameraDelay, EventTime, EventTimeState, microseconds
from camtopod.records import Event

BOOTS_PER_CAMERA_MAX = 16
"""Boots (runs of the publisher) remembered for each camera; beyond, the oldest is forgotten."""
GAPS_PER_BOOT_MAX = 1024
"""Ranges of sequence numbers remembered per boot; beyond, the oldest gap counts as received."""

EVENTS_PER_SECOND_MAX = 50.0
"""Limit of the events learned per camera and tick, per second of the tick; the newest count."""
TICK_EVENTS_MIN = 1000
"""Least limit of the events learned per camera and tick, however short the tick is."""


_Key = tuple[int, str, str, float, float, str, str, int]
"""Sort key of an event: time (microseconds), camera, kind, x, y, track, boot, seq."""


class ReorderBufferState(Struct):
    """The saved state of an `ReorderBuffer`.

    seen: (camera, boot, starts, ends) of every `ReceivedNumbers`.
    newest: `ReorderBuffer.newest_of`.
    """

    newest_us: int | None
    second_us: int | None
    leader: str | None
    watermark_us: int | None
    counts: dict[str, int]
    held: list[Event]
    cameras: list[str]
    seen: list[tuple[str, str, list[int], list[int]]]
    behind: dict[str, CameraDelay] = {}
    newest: dict[str, int] = {}
    surplus: int = 0


class ReceivedNumbers:
    """The sequence numbers received of one boot: disjoint ranges, merged as gaps are filled."""

    def __init__(self) -> None:
        self.starts: list[int] = []
        self.ends: list[int] = []  # inclusive

    def add(self, seq: int) -> bool:
        """Add ``seq``; return False if it had been received before."""
        # The range that starts at or before it.
        starts, ends = self.starts, self.ends
        k = bisect_right(starts, seq) - 1
        if k >= 0 and seq <= ends[k]:
            return False

        # Extend the neighbouring ranges, or insert a new one.
        joins_left = k >= 0 and ends[k] == seq - 1
        joins_right = k + 1 < len(starts) and starts[k + 1] == seq + 1
        if joins_left and joins_right:
            ends[k] = ends.pop(k + 1)
            starts.pop(k + 1)
        elif joins_left:
            ends[k] = seq
        elif joins_right:
            starts[k + 1] = seq
        else:
            starts.insert(k + 1, seq)
            ends.insert(k + 1, seq)

        # Close the oldest gap if there are too many.
        if len(starts) > GAPS_PER_BOOT_MAX:
            starts.pop(1)
            ends.pop(0)
        return True


class ReorderBuffer:
    """Accepts events in any order and returns them ordered by time.

    lateness_seconds, clocks_apart_seconds: see `IdleEventTime`.
    cameras_max: events of further cameras are refused.
    tick_seconds: length of a tick of event time.
    """

    def __init__(
        self,
        lateness_seconds: float,
        cameras_max: int,
        clocks_apart_seconds: float = 0.0,
        tick_seconds: float = 60.0,
    ) -> None:
        self.time = EventTime(lateness_seconds, clocks_apart_seconds)
        """Event time and watermark."""
        self._tick_us = microseconds(tick_seconds)
        self._tick_events_max = max(int(EVENTS_PER_SECOND_MAX * tick_seconds), TICK_EVENTS_MIN)
        self.cameras_max = cameras_max
        self.counts = {"accepted": 0, "duplicate": 0, "late": 0, "refused": 0}
        self.surplus = 0
        """Accepted events that are not learned because of `EVENTS_PER_SECOND_MAX`."""
        # Held events by tick and camera, and the time of the oldest.
        self._held: dict[tuple[int, str], list[Event]] = {}
        self._oldest_us: int | None = None
        # Received sequence numbers by camera and boot.
        self._seen: dict[str, dict[str, ReceivedNumbers]] = {}
        self.newest_of: dict[str, int] = {}
        """Time of the newest event of each camera in microseconds, late events included.

        The camera of the last received event is at the end.
        """

    @property
    def newest_us(self) -> int | None:
        """Time of the newest event, see `IdleEventTime`."""
        return self.time.newest_us

    @property
    def watermark_us(self) -> int | None:
        """Events older than this are late; None before the first event."""
        return self.time.watermark_us

    @property
    def lateness_us(self) -> int:
        """By how much the watermark trails event time, in microseconds."""
        return self.time.lateness_us

    def save(self) -> ReorderBufferState:
        """Return the state from which `load` continues."""
        seen = [
            (camera, boot, sequence.starts, sequence.ends)
            for camera, boots in self._seen.items()
            for boot, sequence in boots.items()
        ]
        time = self.time.save()
        return ReorderBufferState(
            time.newest_us,
            time.second_us,
            time.leader,
            time.watermark_us,
            self.counts,
            self._all_held(),
            list(self._seen),
            seen,
            time.behind,
            self.newest_of,
            self.surplus,
        )

    def load(self, state: ReorderBufferState) -> None:
        """Continue from a saved state; this buffer must be new."""
        self.time.load(
            EventTimeState(
                state.newest_us, state.second_us, state.leader, state.watermark_us, state.behind
            )
        )
        self.counts, self.surplus = state.counts, state.surplus
        for event in state.held:
            self._hold(event, microseconds(event.t))
        self._seen = {camera: {} for camera in state.cameras}
        for camera, boot, starts, ends in state.seen:
            sequence = self._seen[camera][boot] = ReceivedNumbers()
            sequence.starts, sequence.ends = starts, ends
        self.newest_of = state.newest

    def receive(self, event: Event) -> str:
        """Receive one event and return the verdict.

        It is ``accepted``, ``duplicate``, ``late`` or ``refused`` (too many cameras).
        """
        verdict = self._judge(event)
        self.counts[verdict] += 1
        return verdict

    def has_room_for(self, camera: str) -> bool:
        """Return True if the camera is known or there is room for one more."""
        return camera in self._seen or len(self._seen) < self.cameras_max

    def _judge(self, event: Event) -> str:
        """Return the verdict on an event, and hold it if it is accepted."""
        if not self.has_room_for(event.camera):
            return "refused"

        # The camera has been active.
        boots, t_us = self._seen.setdefault(event.camera, {}), microseconds(event.t)
        self.newest_of[event.camera] = max(t_us, self.newest_of.pop(event.camera, t_us))

        # Was the event received before?
        if event.boot is not None and event.seq is not None:
            sequence = boots.get(event.boot)
            if sequence is None:
                sequence = boots[event.boot] = ReceivedNumbers()
                if len(boots) > BOOTS_PER_CAMERA_MAX:
                    del boots[next(iter(boots))]
            if not sequence.add(event.seq):
                return "duplicate"

        # Is it too late?
        if not self.time.note(t_us, event.camera):
            return "late"
        self._hold(event, t_us)
        return "accepted"

    def advance(self, now_us: int) -> None:
        """Advance event time to ``now_us`` without an event."""
        self.time.advance(now_us)

    @property
    def cameras(self) -> list[str]:
        """Names of the known cameras."""
        return list(self._seen)

    def cameras_held(self) -> set[str]:
        """Return the cameras that have held events."""
        return {camera for _, camera in self._held}

    def forget(self, names: Set[str]) -> None:
        """Forget these cameras, except for their held events."""
        for known in (self._seen, self.newest_of):
            for name in names & known.keys():
                del known[name]
        self.time.forget(names)

    def take_until(self, until_us: int) -> list[tuple[int, Event]]:
        """Remove and return the held events with time <= ``until_us``.

        They come as (microseconds, event) in canonical order.
        """
        held = [event for waiting in self._held.values() for event in self._newest(waiting)]
        self._held, self._oldest_us = {}, None
        due = []
        for event in held:
            t_us = microseconds(event.t)
            if t_us <= until_us:
                due.append((t_us, event))
            else:
                self._hold(event, t_us)
        return _in_order(due)

    def _hold(self, event: Event, t_us: int) -> None:
        """Hold an event until the watermark has passed it."""
        key = -(-t_us // self._tick_us), event.camera
        waiting = self._held.setdefault(key, [])
        waiting.append(event)
        # Sort only once a quarter more events are held than count.
        if 4 * len(waiting) > 5 * self._tick_events_max:
            self._held[key] = self._newest(waiting)
        self._oldest_us = t_us if self._oldest_us is None else min(self._oldest_us, t_us)

    def _newest(self, waiting: list[Event]) -> list[Event]:
        """Return those of the held events of one camera and tick that count."""
        if len(waiting) <= self._tick_events_max:
            return waiting
        self.surplus += len(waiting) - self._tick_events_max
        return sorted(waiting, key=_sort_key)[-self._tick_events_max :]

    def _all_held(self) -> list[Event]:
        return [event for waiting in self._held.values() for event in waiting]

    @property
    def oldest_held_us(self) -> int | None:
        """Time of the oldest held event in microseconds."""
        return self._oldest_us

    @property
    def held_count(self) -> int:
        """Number of held events."""
        return sum(map(len, self._held.values()))


def _in_order(timed: list[tuple[int, Event]]) -> list[tuple[int, Event]]:
    """Sort (microseconds, event) into canonical order, in place; full keys only for equal times."""
    timed.sort(key=itemgetter(0))
    first = 0
    for k in range(1, len(timed) + 1):
        if k == len(timed) or timed[k][0] != timed[first][0]:
            if k - first > 1:
                timed[first:k] = sorted(timed[first:k], key=lambda one: _sort_key(one[1]))
            first = k
    return timed


def _sort_key(event: Event) -> _Key:
    """Return an event's key in the canonical order: its time, then everything else.

    So the order of events at the same time does not depend on that in which they are received.
    """
    x, y = (-1.0, -1.0) if event.x is None or event.y is None else (event.x, event.y)
    seq = -1 if event.seq is None else event.seq
    track = "" if event.track is None else f"={event.track}"
    return (microseconds(event.t), event.camera, event.kind, x, y, track, event.boot or "", seq)
