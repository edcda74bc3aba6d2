"""Reorder buffer with a watermark: receives events in any order, releases them in order of time.

An event at or after the watermark is held until the watermark has passed it. An event before the
watermark is late: it is counted, but not learned. So the released events do not depend on the order
in which events are received, as long as none is later than the lateness allows. (See
`camtopod.event_time` for event time, watermark and lateness.) An event with the same (camera, boot,
seq) as an earlier one is a duplicate and is dropped; a *boot* is one run of the program that
publishes the camera, and *seq* numbers the events of a boot.

Memory is limited: for each camera and tick of event time, at most `EVENTS_PER_SECOND_MAX` events
per second are kept, the newest ones. No real view reaches that rate, and which events are kept does
not depend on the order in which they are received either.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Set
from operator import itemgetter

from msgspec import Struct, field

from camtopod.event_time import EventTime, EventTimeState, microseconds
from camtopod.records import Event

BOOTS_PER_CAMERA_MAX = 16
"""Boots remembered for each camera; beyond, the oldest is forgotten."""
GAPS_PER_BOOT_MAX = 1024
"""Ranges of sequence numbers remembered per boot; beyond, the oldest gap counts as received."""

EVENTS_PER_SECOND_MAX = 50.0
"""Events learned per camera and tick, per second of the tick; of more, the newest count."""
TICK_EVENTS_MIN = 1000
"""Lower bound on the limit of events per camera and tick, for short ticks."""


_Key = tuple[int, str, str, float, float, str, str, int]
"""Sort key of an event: time (microseconds), camera, kind, x, y, track, boot, seq."""


class ReorderBufferState(Struct):
    """The saved state of a `ReorderBuffer`.

    time: state of event time.
    counts: number of events by verdict (`ReorderBuffer.receive`).
    held: events that wait for the watermark.
    cameras: the known cameras.
    seen: (camera, boot, starts, ends) of every `ReceivedNumbers`.
    newest: `ReorderBuffer.newest_of`.
    surplus: `ReorderBuffer.surplus`.
    """

    time: EventTimeState = field(default_factory=EventTimeState)
    counts: dict[str, int] = {}
    held: list[Event] = []
    cameras: list[str] = []
    seen: list[tuple[str, str, list[int], list[int]]] = []
    newest: dict[str, int] = {}
    surplus: int = 0


class ReceivedNumbers:
    """Set of the sequence numbers received from one boot, as disjoint ranges in ascending order.

    starts, ends: first and last number of each range.
    """

    def __init__(self) -> None:
        self.starts: list[int] = []
        self.ends: list[int] = []

    def add(self, seq: int) -> bool:
        """Add a sequence number; return False if it had been received before."""
        # The range that starts at or before ``seq``.
        starts = self.starts
        ends = self.ends
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
    """Receives events in any order and releases them in order of time.

    lateness_seconds: by how much the watermark trails event time at least (`EventTime`).
    cameras_max: number of cameras whose events are accepted; events of further ones are refused.
    clocks_apart_seconds: the largest expected difference of two cameras' clocks (`EventTime`).
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
        """Number of accepted events that were dropped because of `EVENTS_PER_SECOND_MAX`."""
        # Held events by (tick, camera), and the time of the oldest held event.
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
        """Time of the newest event in microseconds, or of `advance` if that is newer."""
        return self.time.newest_us

    @property
    def watermark_us(self) -> int | None:
        """The watermark in microseconds: older events are late. None before the first event."""
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
        return ReorderBufferState(
            self.time.save(),
            self.counts,
            self._all_held(),
            list(self._seen),
            seen,
            self.newest_of,
            self.surplus,
        )

    def load(self, state: ReorderBufferState) -> None:
        """Continue from a saved state; this buffer must be new."""
        self.time.load(state.time)
        self.counts = {**self.counts, **state.counts}
        self.surplus = state.surplus
        for event in state.held:
            self._hold(event, microseconds(event.t))
        self._seen = {camera: {} for camera in state.cameras}
        for camera, boot, starts, ends in state.seen:
            sequence = self._seen[camera][boot] = ReceivedNumbers()
            sequence.starts = starts
            sequence.ends = ends
        self.newest_of = state.newest

    def receive(self, event: Event) -> str:
        """Receive one event, hold it if it is accepted, and return the verdict.

        The verdict is ``accepted``, ``duplicate``, ``late`` or ``refused`` (too many cameras).
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

        # Note the time of the camera's newest event.
        boots = self._seen.setdefault(event.camera, {})
        t_us = microseconds(event.t)
        self.newest_of[event.camera] = max(t_us, self.newest_of.pop(event.camera, t_us))

        # A duplicate if its sequence number was received before.
        if event.boot is not None and event.seq is not None:
            sequence = boots.get(event.boot)
            if sequence is None:
                sequence = boots[event.boot] = ReceivedNumbers()
                if len(boots) > BOOTS_PER_CAMERA_MAX:
                    del boots[next(iter(boots))]
            if not sequence.add(event.seq):
                return "duplicate"

        # Late if it is before the watermark.
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

    def drop_held(self, names: Set[str]) -> None:
        """Drop the held events of these cameras."""
        kept = [event for event in self._all_held() if event.camera not in names]
        self._held = {}
        self._oldest_us = None
        for event in kept:
            self._hold(event, microseconds(event.t))

    def forget(self, names: Set[str]) -> None:
        """Forget these cameras, except for their held events."""
        for known in (self._seen, self.newest_of):
            for name in names & known.keys():
                del known[name]
        self.time.forget(names)

    def take_until(self, until_us: int) -> list[tuple[int, Event]]:
        """Remove and return the held events up to ``until_us``, as (microseconds, event).

        They are in canonical order: by time, events at the same time by their content.
        """
        held = [event for waiting in self._held.values() for event in self._newest(waiting)]
        self._held = {}
        self._oldest_us = None
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
        """Return the held events of one camera and tick without those beyond the limit."""
        if len(waiting) <= self._tick_events_max:
            return waiting
        self.surplus += len(waiting) - self._tick_events_max
        return sorted(waiting, key=_sort_key)[-self._tick_events_max :]

    def _all_held(self) -> list[Event]:
        """Return all held events, in no particular order."""
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
    """Sort (microseconds, event) into canonical order, in place, and return the list.

    The full sort key, which is slow, is computed for events at equal times only.
    """
    timed.sort(key=itemgetter(0))
    first = 0
    for k in range(1, len(timed) + 1):
        if k == len(timed) or timed[k][0] != timed[first][0]:
            if k - first > 1:
                timed[first:k] = sorted(timed[first:k], key=lambda one: _sort_key(one[1]))
            first = k
    return timed


def _sort_key(event: Event) -> _Key:
    """Return an event's key in the canonical order: its time, then its other fields.

    With this key, the order of events at the same time does not depend on the order in which they
    are received.
    """
    x, y = (-1.0, -1.0) if event.x is None or event.y is None else (event.x, event.y)
    seq = -1 if event.seq is None else event.seq
    track = "" if event.track is None else f"={event.track}"
    return (microseconds(event.t), event.camera, event.kind, x, y, track, event.boot or "", seq)
