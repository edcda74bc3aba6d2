"""Events of each camera by the hour, counted from the daemon's status while this server runs."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

HOURS_MAX = 48
"""Hours that are kept of each camera."""


class HourlyEvents:
    """A ring of hourly counts for each camera; for one thread that notes and others that read."""

    def __init__(self) -> None:
        self._counted: dict[str, int] = {}
        """The daemon's counter of each camera, as of the last status."""
        self._hours: dict[str, deque[tuple[int, int]]] = {}
        """By camera: (hour since the epoch, events in it), hours without events left out."""
        self._since: float | None = None

    def note(self, now: float, counters: Mapping[str, int]) -> None:
        """Take note of a status of the daemon.

        now: Unix seconds.
        counters: events of each camera since the daemon's start.
        """
        hour = int(now // 3600)
        first = self._since is None
        if self._since is None:
            self._since = now
        for camera, counter in counters.items():
            # The counter starts at 0 when the daemon starts, and for a camera that is new.
            before = self._counted.get(camera, counter if first else 0)
            self._counted[camera] = counter
            if new := counter - before if counter >= before else counter:
                held = self._hours.setdefault(camera, deque(maxlen=HOURS_MAX))
                count = held.pop()[1] if held and held[-1][0] == hour else 0
                held.append((hour, count + new))

    def of(self, camera: str, now: float) -> dict[str, object] | None:
        """Return a camera's events by the hour; None before the first status.

        ``since``: when counting began, Unix seconds. ``first``: beginning of the first hour.
        ``counts``: events in each hour, up to the hour of ``now``.
        """
        if self._since is None:
            return None
        last = int(now // 3600)
        first = max(int(self._since // 3600), last - HOURS_MAX + 1)
        held = dict(self._hours.get(camera, ()))
        return {
            "since": self._since,
            "first": first * 3600,
            "counts": [held.get(hour, 0) for hour in range(first, last + 1)],
        }
