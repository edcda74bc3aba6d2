"""Reorder buffer with a watermark: whatever the order of arrival, the rest of the learner sees
events by time.

Theory of operation. The watermark trails event time by the lateness. An event at or above the
watermark is held until the watermark has passed it; one below is late: counted, not learned. So any
order of arrival within the lateness gives the same sequence out. Event time is where a second
camera has come to, so that a single one whose clock is ahead makes nobody else late; but it is at
most ``apart`` behind the first, so that silent cameras hold nobody up. A camera whose events are
mostly late, but by no more than ``apart``, has a clock that is behind: from then on it is waited
for. An event with (camera, boot, seq) counts once however often it comes.

What is held is limited: of each camera and tick of event time the newest events count, up to a rate
that nothing that is seen by a camera has. Which these are does not depend on the order of arrival
either.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Set
from operator import itemgetter

from msgspec import Struct

from camtopod.event_time import Behind, EventTime, EventTimeState, microseconds
from camtopod.records import Event

BOOTS_PER_CAMERA_MAX = 16
"""Incarnations of one publisher that are remembered; the oldest is forgotten."""
GAPS_PER_BOOT_MAX = 1024
"""Gaps in one incarnation's count that are remembered; beyond, the oldest gap counts as
delivered.
"""

EVENTS_PER_SECOND_MAX = 50.0
"""Events that are learned from in a tick of event time, by camera and second: of more, the newest
of the tick.
"""
TICK_EVENTS_MIN = 1000
"""So many are in any case, however short the tick is."""


_Key = tuple[int, str, str, float, float, str, str, int]


class IntakeState(Struct):
    """What an `Intake` knows. ``seen``: (camera, boot, starts, ends) of every `Sequence`;
    ``newest``: see `Intake`.
    """

    newest_us: int | None
    second_us: int | None
    leader: str | None
    watermark_us: int | None
    counts: dict[str, int]
    held: list[Event]
    cameras: list[str]
    seen: list[tuple[str, str, list[int], list[int]]]
    behind: dict[str, Behind] = {}
    newest: dict[str, int] = {}
    surplus: int = 0


class Sequence:
    """Which numbers of one incarnation have been seen: disjoint ranges, merged as gaps fill."""

    def __init__(self) -> None:
        self.starts: list[int] = []
        self.ends: list[int] = []  # inclusive

    def add(self, seq: int) -> bool:
        """Note ``seq``; False when it had been seen before."""
        starts, ends = self.starts, self.ends
        k = bisect_right(starts, seq) - 1
        if k >= 0 and seq <= ends[k]:
            return False
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
        if len(starts) > GAPS_PER_BOOT_MAX:
            starts.pop(1)
            ends.pop(0)
        return True


class Intake:
    """Events in any order in, events by time out."""

    def __init__(
        self,
        lateness_seconds: float,
        cameras_max: int,
        clocks_apart_seconds: float = 0.0,
        tick_seconds: float = 60.0,
    ) -> None:
        self.time = EventTime(lateness_seconds, clocks_apart_seconds)
        """How far event time has come."""
        self._tick_us = microseconds(tick_seconds)
        self._tick_events_max = max(int(EVENTS_PER_SECOND_MAX * tick_seconds), TICK_EVENTS_MIN)
        self.cameras_max = cameras_max
        self.counts = {"accepted": 0, "duplicate": 0, "late": 0, "refused": 0}
        self.surplus = 0
        """Events of those accepted that are not learned from, see `EVENTS_PER_SECOND_MAX`."""
        self._held: dict[tuple[int, str], list[Event]] = {}  # by tick and camera
        self._oldest_us: int | None = None  # of those held
        self._seen: dict[str, dict[str, Sequence]] = {}
        self.newest_of: dict[str, int] = {}
        """Time of the newest event of each camera, late ones included, in microseconds; the camera
        that has been heard of last comes last.
        """

    @property
    def newest_us(self) -> int | None:
        """The newest event time there has been."""
        return self.time.newest_us

    @property
    def watermark_us(self) -> int | None:
        """Nothing older will be learned any more; None before the first event."""
        return self.time.watermark_us

    @property
    def lateness_us(self) -> int:
        """By how much the watermark trails event time."""
        return self.time.lateness_us

    def save(self) -> IntakeState:
        """Everything `load` needs to go on from here."""
        seen = [
            (camera, boot, sequence.starts, sequence.ends)
            for camera, boots in self._seen.items()
            for boot, sequence in boots.items()
        ]
        time = self.time.save()
        return IntakeState(
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

    def load(self, state: IntakeState) -> None:
        """Go on from there."""
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
            sequence = self._seen[camera][boot] = Sequence()
            sequence.starts, sequence.ends = starts, ends
        self.newest_of = state.newest

    def receive(self, event: Event) -> str:
        """Take one event; the verdict is ``accepted``, ``duplicate``, ``late`` or ``refused`` (too
        many cameras)."""
        verdict = self._judge(event)
        self.counts[verdict] += 1
        return verdict

    def has_place(self, camera: str) -> bool:
        """Whether an event of the camera would not be refused."""
        return camera in self._seen or len(self._seen) < self.cameras_max

    def _judge(self, event: Event) -> str:
        if not self.has_place(event.camera):
            return "refused"
        boots, t_us = self._seen.setdefault(event.camera, {}), microseconds(event.t)
        self.newest_of[event.camera] = max(t_us, self.newest_of.pop(event.camera, t_us))
        if event.boot is not None and event.seq is not None:
            sequence = boots.get(event.boot)
            if sequence is None:
                sequence = boots[event.boot] = Sequence()
                if len(boots) > BOOTS_PER_CAMERA_MAX:
                    del boots[next(iter(boots))]
            if not sequence.add(event.seq):
                return "duplicate"
        if not self.time.note(t_us, event.camera):
            return "late"
        self._hold(event, t_us)
        return "accepted"

    def advance(self, now_us: int) -> None:
        """Event time has come to ``now`` although no event says so."""
        self.time.advance(now_us)

    @property
    def cameras(self) -> list[str]:
        """Cameras that have a place."""
        return list(self._seen)

    def held_of(self) -> set[str]:
        """Cameras of which events wait for the watermark."""
        return {camera for _, camera in self._held}

    def forget(self, names: Set[str]) -> None:
        """Forget these cameras, but for their events that wait for the watermark."""
        for known in (self._seen, self.newest_of):
            for name in names & known.keys():
                del known[name]
        self.time.forget(names)

    def take(self, until_us: int) -> list[tuple[int, Event]]:
        """Remove and return the held events with time <= ``until_us`` as (microseconds, event), in
        canonical order."""
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
        key = -(-t_us // self._tick_us), event.camera
        waiting = self._held.setdefault(key, [])
        waiting.append(event)
        if (
            4 * len(waiting) > 5 * self._tick_events_max
        ):  # a few more than count, as sorting takes its time
            self._held[key] = self._newest(waiting)
        self._oldest_us = t_us if self._oldest_us is None else min(self._oldest_us, t_us)

    def _newest(self, waiting: list[Event]) -> list[Event]:
        """Those of one camera and tick that count."""
        if len(waiting) <= self._tick_events_max:
            return waiting
        self.surplus += len(waiting) - self._tick_events_max
        return sorted(waiting, key=_order)[-self._tick_events_max :]

    def _all_held(self) -> list[Event]:
        return [event for waiting in self._held.values() for event in waiting]

    @property
    def oldest_held_us(self) -> int | None:
        """Time of the oldest event still held."""
        return self._oldest_us

    @property
    def held(self) -> int:
        """Number of events waiting for the watermark."""
        return sum(map(len, self._held.values()))


def _in_order(timed: list[tuple[int, Event]]) -> list[tuple[int, Event]]:
    """Events with their times (microseconds) in canonical order; whole keys are made only of those
    at one time.
    """
    timed.sort(key=itemgetter(0))
    first = 0
    for k in range(1, len(timed) + 1):
        if k == len(timed) or timed[k][0] != timed[first][0]:
            if k - first > 1:
                timed[first:k] = sorted(timed[first:k], key=lambda one: _order(one[1]))
            first = k
    return timed


def _order(event: Event) -> _Key:
    """Total order of events: by time, then by everything else, so that ties do not depend on the
    order of arrival."""
    x, y = (-1.0, -1.0) if event.x is None or event.y is None else (event.x, event.y)
    seq = -1 if event.seq is None else event.seq
    track = "" if event.track is None else f"={event.track}"
    return (microseconds(event.t), event.camera, event.kind, x, y, track, event.boot or "", seq)
