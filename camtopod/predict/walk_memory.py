"""The passages of the last hour, as steps of walks: those in view, those that ended, their names.

An entry may continue a passage for the longest lag of the version; afterwards the passage keeps but
its name and what it continues, so that walks keep theirs for an hour (`WalkMemory.forget_old`).
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Collection, Iterable

from camtopod.predict.passages import OpenPassages
from camtopod.predict.walk_graph import WalkStep
from camtopod.records import Event

CANDIDATES_MAX = 50
"""Number of the newest exits of a zone, and of the newest open passages of a camera, that an entry
may continue.
"""
REVISE_SECONDS = 10.0
"""Seconds after an entry at which its match is looked at once more."""
MEMORY_SECONDS = 3600.0
"""Seconds after its last event at which a passage is forgotten."""
EVENTS_MAX = 200_000
"""Largest number of events whose passages are remembered."""


class WalkMemory:
    """Passages by camera and by zone; events come about in order of time."""

    def __init__(self) -> None:
        self.open: OpenPassages[WalkStep] = OpenPassages()
        """Passages in view; one without a track has its name as that."""
        self._ended_steps: dict[tuple[str, str], WalkStep] = {}
        """The newest passages that ended, by (camera, track), as far as they may be continued."""
        self.steps_by_exit: dict[int, deque[WalkStep]] = {}
        """The newest passages by zone of exit, oldest first."""
        self.recent: deque[WalkStep] = deque()
        """Entries whose match has been given once, oldest first."""
        self._events: deque[tuple[float, WalkStep]] = deque()
        """The events whose passages may be continued: time and passage, oldest first."""
        self._past_events: deque[tuple[float, WalkStep]] = deque()
        """The events before these, as far as walks are named by them."""
        self._names: set[str] = set()
        """Names of the passages."""

    def steps(self) -> list[WalkStep]:
        """Return all passages, oldest first."""
        return _steps(itertools.chain(self._past_events, self._events))

    def begin(self, event: Event, entry: int | None, t: float) -> WalkStep:
        """Return the passage that begins with an event, under a name of its own.

        It is a new one, or that of an exit that was heard before its entry.

        entry: index of the zone of entry; None if unknown.
        t (seconds): corrected time of the event.
        """
        first = f"{event.camera}@{event.t:.6f}".rstrip("0").rstrip(".")
        names = itertools.chain([first], (f"{first}/{number}" for number in itertools.count(2)))
        name = next(name for name in names if name not in self._names)
        track = None if event.track is None else str(event.track)
        step = WalkStep(event.camera, track, event.t, name, entry, t)
        ended_step = self._ended_steps.get((event.camera, track or ""))
        if event.kind == "entry" and ended_step and event.t <= ended_step.t == ended_step.exit_t:
            self._names.discard(ended_step.name)
            ended_step.begin_as(step)
            step = ended_step
        step.label = step.label or event.label
        self._events.append((event.t, step))
        self._names.add(name)
        return step

    def add_open(self, step: WalkStep) -> None:
        """Add a passage that has begun to those in view, unless its exit was heard."""
        ended_step = self._ended_steps.get((step.camera, step.track or ""), step)
        if step.exit_t is None and (ended_step.exit_t or -math.inf) <= step.t:
            self.open.begin(step.camera, step.track or step.name, step)

    def end(self, step: WalkStep, zone: int | None, t: float) -> None:
        """Add the exit of a passage.

        zone: its index; None if unknown.
        t (seconds): time of the exit by the camera's clock.
        """
        step.exit_t = t
        self._events.append((t, step))
        if step.track:
            self._ended_steps[step.camera, step.track] = step
        if zone is not None:
            step.zone = zone
            self.steps_by_exit.setdefault(zone, deque(maxlen=CANDIDATES_MAX)).append(step)

    def forget_old(self, now: float, lag_max: float) -> None:
        """Forget what cannot be continued any more, and the names of walks after an hour.

        lag_max (seconds): longest lag at which a passage is continued.
        """
        # Passages that ended longer ago.
        longest = lag_max + REVISE_SECONDS
        while self._events and (
            now - self._events[0][0] > longest or len(self._events) > EVENTS_MAX
        ):
            t, step = event = self._events.popleft()
            self._past_events.append(event)
            if t == step.exit_t:
                self._release(step)

        # Passages that have had no event for an hour, and the oldest of too many.
        while self._past_events and (
            now - self._past_events[0][0] > MEMORY_SECONDS
            or len(self._past_events) + len(self._events) > EVENTS_MAX
        ):
            t, step = self._past_events.popleft()
            if t < (step.t if step.exit_t is None else step.exit_t):
                continue
            self._names.discard(step.name)
            step.is_forgotten = True
            key = step.track or step.name
            if self.open.of(step.camera).get(key) is step:
                self.open.end(step.camera, key)
            self._release(step)
            step.before = None
        while self.recent and self.recent[0].is_final:
            self.recent.popleft()

    def _release(self, step: WalkStep) -> None:
        """Release the state that matching needs of a passage."""
        step.is_final = True
        if self._ended_steps.get(key := (step.camera, step.track or "")) is step:
            del self._ended_steps[key]
        if step in (zone_steps := self.steps_by_exit.get(step.zone, deque())):
            zone_steps.remove(step)
        step.edges, step.claims, step.expected = [], {}, None

    def forget_cameras(self, cameras: Collection[str]) -> None:
        """Forget the passages of cameras; a passage that continued one of them begins a walk."""
        steps = self.steps()
        names = {step.name for step in steps if step.camera in cameras}
        for step in steps:
            step.is_forgotten |= step.name in names
        self._events, self._past_events = (
            deque(event for event in events if event[1].name not in names)
            for events in (self._events, self._past_events)
        )
        self.recent = deque(step for step in self.recent if step.name not in names)
        self._ended_steps = {
            key: step for key, step in self._ended_steps.items() if key[0] not in cameras
        }
        self._names -= names
        for camera in cameras:
            for key in list(self.open.of(camera)):
                self.open.end(camera, key)
        for zone_steps in self.steps_by_exit.values():
            for step in [step for step in zone_steps if step.name in names]:
                zone_steps.remove(step)

        # What other passages know of them.
        for step in steps:
            step.edges = [edge for edge in step.edges if edge.source.name not in names]
            for claims in step.claims.values():
                claims.edges = [edge for edge in claims.edges if edge.entry.name not in names]
                claims.odds = sum(edge.weight * edge.message for edge in claims.edges)

    def move(self, new_zones: dict[int, int], zones: int) -> None:
        """Go on with the zones of another version.

        new_zones: new index of each of the ``zones`` old ones, without those that are gone.
        """
        if new_zones != {zone: zone for zone in range(zones)}:
            in_view = (step for _, step in self.open.passages())
            for step in _steps(self._events, in_view):
                step.entry = new_zones.get(-1 if step.entry is None else step.entry)
        self.steps_by_exit = {
            new_zones[zone]: steps
            for zone, steps in self.steps_by_exit.items()
            if zone in new_zones
        }
        for zone, steps in self.steps_by_exit.items():
            for step in steps:
                step.zone, step.expected = zone, None


def _steps(
    events: Iterable[tuple[float, WalkStep]], further_steps: Iterable[WalkStep] = ()
) -> list[WalkStep]:
    """Return the passages of some events, and further steps, each once."""
    steps = itertools.chain((step for _, step in events), further_steps)
    return list({id(step): step for step in steps}.values())
