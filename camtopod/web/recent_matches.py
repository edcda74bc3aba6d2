"""The matches of the last hour, so that programs and pages that come later see the walks."""

from __future__ import annotations

import threading
from collections.abc import Collection

from camtopod.records import Match
from camtopod.statuses import without_cameras

MATCHES_SECONDS = 3600.0
"""Age of an entry up to which its match is kept."""
MATCHES_MAX = 20_000
"""Largest number of matches that are kept; beyond it the oldest are forgotten."""


class RecentMatches:
    """The newest match of each entry; for any thread."""

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._matches: dict[tuple[str, float, str | None], Match] = {}
        """By camera, time and track of the entry, in the order in which they first arrived."""

    def add(self, match: Match, now: float) -> None:
        """Add a match; it takes the place of an earlier one of the same entry.

        now: Unix seconds.
        """
        with self._mutex:
            self._matches[match.camera, match.t, match.track] = match
            while len(self._matches) > MATCHES_MAX or self._oldest() < now - MATCHES_SECONDS:
                del self._matches[next(iter(self._matches))]

    def later(self, since: float, now: float) -> list[Match]:
        """Return the matches of entries later than ``since``, in order of time."""
        since = max(since, now - MATCHES_SECONDS)
        with self._mutex:
            matches = [match for match in self._matches.values() if match.t > since]
        return sorted(matches, key=lambda match: match.t)

    def forget(self, cameras: Collection[str]) -> None:
        """Forget the matches that name any of the cameras, and the walks through them."""
        with self._mutex:
            matches = without_cameras(self._matches.values(), cameras)
            self._matches = {(match.camera, match.t, match.track): match for match in matches}

    def clear(self) -> None:
        """Forget all matches."""
        with self._mutex:
            self._matches.clear()

    def _oldest(self) -> float:
        """Return the time of the entry whose match arrived first; infinite without matches."""
        return next(iter(self._matches.values())).t if self._matches else float("inf")
