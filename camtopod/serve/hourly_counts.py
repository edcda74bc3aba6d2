"""Entries and exits of each camera by the hour, counted by the daemon; in memory only."""

from __future__ import annotations

from collections.abc import Collection

from camtopod.records import EventHours, SeenEvent

HOURS_MAX = 25
"""Hours that are kept: the present one and a day before it."""
HOUR_SECONDS = 3600


class HourlyCounts:
    """Counts of the last hours, of cameras whose number the intake limits."""

    def __init__(self, since: float) -> None:
        self.since = since
        """When counting began, Unix seconds."""
        self._hours: dict[int, dict[str, list[int]]] = {}
        """By hour since 1970: entries and exits of each camera."""

    def add(self, event: SeenEvent) -> None:
        """Count an event, unless newer ones have made it too old."""
        hour = int(event.t // HOUR_SECONDS)
        if hour not in self._hours:
            self._hours[hour] = {}
            for old in sorted(self._hours)[:-HOURS_MAX]:
                del self._hours[old]
        counts = self._hours.get(hour, {}).setdefault(event.camera, [0, 0])
        counts[event.kind == "exit"] += 1

    def forget_cameras(self, cameras: Collection[str]) -> None:
        """Forget the counts of cameras."""
        for counts in self._hours.values():
            for camera in cameras:
                counts.pop(camera, None)

    def told(self, now: float) -> EventHours:
        """Return the counts of the hours up to that of ``now``, Unix seconds."""
        last = int(now // HOUR_SECONDS)
        first = max(last - HOURS_MAX + 1, min(self._hours, default=last))
        hours = range(first, last + 1)
        names = {name for hour in hours for name in self._hours.get(hour, {})}
        cameras = {
            name: [self._hours.get(hour, {}).get(name, [0, 0]) for hour in hours]
            for name in sorted(names)
        }
        return EventHours(self.since, float(first * HOUR_SECONDS), cameras)
