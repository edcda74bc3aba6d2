"""Event time that goes on although no event says so."""

from __future__ import annotations

from collections.abc import Iterable


class EventTime:
    """When events in step with the clock have stopped and the learner waits for time, time follows
    the clock.

    By the clock that does not step: when somebody sets this machine's clock, event time stays.
    """

    def __init__(self) -> None:
        self._live: tuple[float, float, float] | None = (
            None  # newest event time in step; wall and steady clock then
        )
        self.deadline: float | None = None
        """Event time at which the learner wants to be told that time went on; set from any
        thread.
        """

    def note(
        self, times: Iterable[float], wall: float, now: float, apart_seconds_max: float
    ) -> None:
        """Times of events; in step are those no further from the clock."""
        newest = max((t for t in times if abs(t - wall) <= apart_seconds_max), default=None)
        if newest is not None:
            self._live = (newest if self._live is None else max(newest, self._live[0]), wall, now)

    def rewind(self) -> None:
        """Event time has gone back: nothing has been in step yet."""
        self._live = None

    def went_on(self, now: float, settle_seconds: float) -> float | None:
        """To when, if that is to be said now: so far behind the clock."""
        if self._live is None or self.deadline is None:
            return None
        newest, wall_then, then = self._live
        quiet = now - then
        advanced = wall_then + quiet - settle_seconds
        if advanced < self.deadline or advanced <= newest or quiet < settle_seconds:
            return None
        self._live = (advanced, wall_then, then)
        self.deadline = None  # until the learner says more: it may be long before it comes to this
        return advanced
