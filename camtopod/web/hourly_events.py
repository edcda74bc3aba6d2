"""Events of each camera by the hour, counted from the daemon's status while this server runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

HOURS_MAX = 48
"""Hours that are kept."""


class HourlyEvents:
    """Counts of the last hours; for one thread that notes and others that read."""

    def __init__(self) -> None:
        self._counters: dict[str, int] = {}
        """The daemon's counter of each camera, as of the last status."""
        self._hours: dict[int, Counter[str]] = {}
        """By hour since the epoch: events of each camera."""
        self._since: float | None = None

    def note(self, now: float, counters: Mapping[str, int]) -> None:
        """Take note of a status of the daemon.

        now: Unix seconds.
        counters: events of each camera since the daemon's start.
        """
        if self._since is None:
            self._since = now
            self._counters.update(counters)
        hour = int(now // 3600)
        counts = self._hours.setdefault(hour, Counter())
        for camera, counter in counters.items():
            before = self._counters.get(camera, 0)
            if counter < before:  # the daemon has been restarted
                before = 0
            counts[camera] += counter - before
        self._counters.update(counters)
        self._hours.pop(hour - HOURS_MAX, None)

    def of(self, camera: str, now: float) -> dict[str, object] | None:
        """Return a camera's events by the hour; None before the first status.

        ``since``: when counting began, Unix seconds. ``first``: beginning of the first hour.
        ``counts``: events in each hour, up to the hour of ``now``.
        """
        if self._since is None:
            return None
        last = int(now // 3600)
        first = max(int(self._since // 3600), last - HOURS_MAX + 1)
        hours = [self._hours.get(hour, Counter()) for hour in range(first, last + 1)]
        counts = [hour[camera] for hour in hours]
        return {"since": self._since, "first": first * 3600, "counts": counts}
