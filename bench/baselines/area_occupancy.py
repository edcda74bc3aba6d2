"""A rule of home automation: who comes next within a minute, between areas that are neighbours.

Home Assistant's integration Area Occupancy Detection learns transitions so; this is written from
its description (docs/technical/transition-learning.md), not from its code. An area becomes vacant,
another occupied within 60 s: a transition, with the area that was vacant before, within 300 s, as
its context. Counts are kept by hour of the week. A prediction takes the most specific counts that
are enough. There, the user says which areas are neighbours.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Sequence, Set

from bench.support.recordings import CameraPair
from camtopod.records import Event

TRANSITION_SECONDS = 60.0
"""Longest time from one area to the next, seconds."""
CONTEXT_SECONDS = 300.0
"""Longest time since the area before, seconds."""
WEEK_HOURS, DAY_HOURS = 168, 24
"""Hours of a week and of a day; counts are kept by both."""
CONTEXT_COUNTS_MIN = {"week": 5, "day": 20, "all": 50}
COUNTS_MIN = {"week": 5, "all": 20}
"""Least transitions from which counts by the hour of the week, of the day, or of all hours are
used: with the area before, and without.
"""
PRIOR_COUNT = 0.05
"""Added to every area's count, so that none is impossible."""

_Place = tuple[str, str, str, int]
"""Camera before ("" without), camera, period, hour."""
_End = tuple[float, str]
"""Time, in seconds, at which a passage ended, and its camera."""


class AreaOccupancy:
    """Counts of transitions, and predictions from them.

    neighbours: pairs of cameras between which transitions count.
    """

    def __init__(self, neighbours: Set[CameraPair]) -> None:
        self._neighbours = neighbours
        self._counts: dict[_Place, Counter[str]] = defaultdict(Counter)
        self._ends: list[_End] = []

    def learn(self, events: Sequence[Event], until: float) -> None:
        """Count the transitions of events by time, until a time in seconds; remember all exits."""
        for event in events:
            if event.kind == "exit":
                self._ends.append((event.t, event.camera))
            elif event.t < until:
                self._count(event)

    def guess(self, camera: str, t: float, cameras: Sequence[str]) -> dict[str, float]:
        """Return the probability of each other camera as the next one after an exit.

        t (seconds): time of the exit, which has been learned.
        """
        hour = int(t // 3600.0)
        last = bisect_left(self._ends, (t, ""))
        before = self._before(camera, t, last)
        counts = self._enough(before, camera, hour, CONTEXT_COUNTS_MIN) if before else None
        if counts is None:
            counts = self._enough("", camera, hour, COUNTS_MIN) or Counter()
        weight = {name: counts[name] + PRIOR_COUNT for name in cameras if name != camera}
        total = sum(weight.values())
        return {name: value / total for name, value in weight.items()}

    def _count(self, entry: Event) -> None:
        """Count the transitions that an entry ends, one from each camera at most."""
        hour, sources = int(entry.t // 3600.0), set[str]()
        for last in range(len(self._ends) - 1, -1, -1):
            t, source = self._ends[last]
            if entry.t - t > TRANSITION_SECONDS:
                break
            if source in sources or (source, entry.camera) not in self._neighbours:
                continue
            sources.add(source)
            self._add("", source, hour, entry.camera)
            before = self._before(source, t, last)
            if before:
                self._add(before, source, hour, entry.camera)

    def _before(self, camera: str, t: float, last: int) -> str:
        """Return the neighbour that was left last before ``camera`` was at ``t``; "" if none was.

        last: number of exits before that one.
        """
        for end in range(last - 1, -1, -1):
            departure, source = self._ends[end]
            if t - departure > CONTEXT_SECONDS:
                break
            if (source, camera) in self._neighbours:
                return source
        return ""

    def _add(self, before: str, camera: str, hour: int, target: str) -> None:
        for period, number in _hours(hour).items():
            self._counts[before, camera, period, number][target] += 1

    def _enough(
        self, before: str, camera: str, hour: int, least: dict[str, int]
    ) -> Counter[str] | None:
        """Return the most specific counts with at least ``least`` transitions; None without."""
        hours = _hours(hour)
        for period, number in least.items():
            counts = self._counts.get((before, camera, period, hours[period]), Counter())
            if counts.total() >= number:
                return counts
        return None


def _hours(hour: int) -> dict[str, int]:
    """Return the hour within each period, by the hour since the epoch."""
    return {"week": hour % WEEK_HOURS, "day": hour % DAY_HOURS, "all": 0}
