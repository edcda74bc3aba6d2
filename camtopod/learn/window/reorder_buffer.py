"""Reorder buffer with a watermark: receives events in any order, releases them in order of time.

An event is held until the watermark has passed it. So the released events do not depend on the
order in which events are received, as long as none is later than the lateness allows. An event
before the watermark is late: it is released with the next ones. (See `camtopod.event_time` for
event time, watermark and lateness.) An event with a number that its camera has used before is a
duplicate and is dropped: a *boot* is one run of the program that publishes the camera, and *seq*
numbers the events of a boot.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Set

from msgspec import Struct, field

from camtopod.event_numbers import EventNumbers
from camtopod.event_time import EventTime, EventTimeState, microseconds
from camtopod.records import Event

HELD_EVENTS_MAX = 100_000
"""Held events from which backlogs are waited for no longer."""


class ReorderBufferState(Struct):
    """The state of a `ReorderBuffer`."""

    time: EventTimeState = field(default_factory=EventTimeState)
    """State of event time."""
    counts: dict[str, int] = field(
        default_factory=lambda: {"accepted": 0, "duplicate": 0, "late": 0, "refused": 0}
    )
    """Number of events by verdict (`ReorderBuffer.receive`)."""
    held: list[Event] = []
    """Events that wait for the watermark."""
    newest: dict[str, int] = {}
    """Time of the newest event of each known camera in microseconds, late events included.

    The camera of the last received event is at the end.
    """
    numbers: dict[str, EventNumbers] = {}
    """The numbers of each camera's events."""


class ReorderBuffer:
    """Receives events in any order and releases them in order of time.

    lateness_seconds: by how much the watermark trails event time (`EventTime`).
    cameras_max: number of cameras whose events are accepted; events of further ones are refused.
    clocks_apart_seconds: the largest expected difference of two cameras' clocks (`EventTime`).
    """

    def __init__(
        self, lateness_seconds: float, cameras_max: int, clocks_apart_seconds: float = 0.0
    ) -> None:
        self.time = EventTime(lateness_seconds, clocks_apart_seconds)
        """Event time and watermark; call its ``advance`` for time that passes without events."""
        self.cameras_max = cameras_max
        self.load(ReorderBufferState())

    def load(self, state: ReorderBufferState) -> None:
        """Continue from a state, which is changed from here on; this buffer must be new."""
        self.state = state
        self.time.load(state.time)
        self.oldest_held_us: int | None = None
        """Time of the oldest held event in microseconds."""
        self._hold_only(state.held)

    def receive(self, event: Event) -> str:
        """Receive one event, hold it if it is accepted or late, and return the verdict.

        The verdict is ``accepted``, ``late``, ``duplicate`` or ``refused`` (too many cameras).
        """
        verdict = self._judge(event)
        self.state.counts[verdict] += 1
        return verdict

    def has_room_for(self, camera: str) -> bool:
        """Return True if the camera is known or there is room for one more."""
        return camera in self.state.newest or len(self.state.newest) < self.cameras_max

    def _judge(self, event: Event) -> str:
        """Return the verdict on an event, and hold it if it is accepted or late."""
        if not self.has_room_for(event.camera):
            return "refused"
        t_us = microseconds(event.t)
        self.state.newest[event.camera] = max(t_us, self.state.newest.pop(event.camera, t_us))

        if event.boot is not None and event.seq is not None:
            numbers = self.state.numbers.setdefault(event.camera, EventNumbers())
            if not numbers.add(event.boot, event.seq):
                return "duplicate"
        self.state.held.append(event)
        self._is_sorted = False
        if len(self.state.held) > HELD_EVENTS_MAX:
            self.time.wait_for(set())
        if self.oldest_held_us is None or t_us < self.oldest_held_us:
            self.oldest_held_us = t_us
        return "accepted" if self.time.note(t_us, event.camera) else "late"

    def note_repeats(self, repeats: int) -> None:
        """Count events that were taken for late ones as duplicates."""
        self.state.counts["late"] -= repeats
        self.state.counts["duplicate"] += repeats

    def cameras_held(self) -> set[str]:
        """Return the cameras that have held events."""
        return {event.camera for event in self.state.held}

    def drop_held(self, names: Set[str]) -> None:
        """Drop the held events of these cameras."""
        self._hold_only([event for event in self.state.held if event.camera not in names])

    def forget(self, names: Set[str]) -> None:
        """Forget these cameras, except for their held events."""
        for name in names:
            self.state.newest.pop(name, None)
            self.state.numbers.pop(name, None)
            self.time.state.waited.pop(name, None)

    def take_until(self, until_us: int) -> list[tuple[int, Event]]:
        """Remove and return the held events up to ``until_us``, as (microseconds, event).

        They are in canonical order: by time, events at the same time by their content.
        """
        if not self._is_sorted:
            self.state.held.sort(key=_newest_first)
            self._is_sorted = True
        held = self.state.held
        first = bisect_left(held, -until_us, key=_newest_first)
        batch = [(microseconds(event.t), event) for event in held[first:]]
        del held[first:]
        self.oldest_held_us = microseconds(held[-1].t) if held else None
        return sorted(batch, key=_sort_key)

    def _hold_only(self, events: list[Event]) -> None:
        """Replace the held events."""
        self.state.held = events
        self._is_sorted = False  # newest first, so that a release of many ticks sorts once
        self.oldest_held_us = min((microseconds(event.t) for event in events), default=None)


def _newest_first(event: Event) -> int:
    """Return the key by which the newest event comes first."""
    return -microseconds(event.t)


def _sort_key(item: tuple[int, Event]) -> tuple[int, str, str, float, float, str, str, int, str]:
    """Return the key of (microseconds, event) in the canonical order: its time, then its content.

    So the order of events at the same time does not depend on the order in which they are received.
    """
    t_us, event = item
    x, y = (-1.0, -1.0) if event.x is None or event.y is None else (event.x, event.y)
    seq = -1 if event.seq is None else event.seq
    track = "" if event.track is None else f"={event.track}"
    label = event.label or ""
    return t_us, event.camera, event.kind, x, y, track, event.boot or "", seq, label
