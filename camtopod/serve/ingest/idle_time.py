"""Advance event time by the clock when no events come."""

from __future__ import annotations

from collections.abc import Iterable


class IdleEventTime:
    """Event time that follows the clock once events in step with it have stopped.

    It does so only while the learner waits for a deadline, and by the steady clock: a step of this
    machine's clock does not move event time.
    """

    def __init__(self) -> None:
        # Newest event time in step with the clock, and the wall and steady clocks then.
        self._live: tuple[float, float, float] | None = None
        self.deadline: float | None = None
        """Event time that the learner waits for; None if it does not. Set from any thread."""

    def note(
        self, times: Iterable[float], wall: float, now: float, apart_seconds_max: float
    ) -> None:
        """Note the times of events.

        Those at most ``apart_seconds_max`` from the clock are in step with it.
        """
        newest = max((t for t in times if abs(t - wall) <= apart_seconds_max), default=None)
        if newest is not None:
            self._live = (newest if self._live is None else max(newest, self._live[0]), wall, now)

    def rewind(self) -> None:
        """Forget what was in step, as event time has gone back."""
        self._live = None

    def advance_to(self, now: float, settle_seconds: float) -> float | None:
        """Return the event time to advance to, ``settle_seconds`` behind the clock, or None."""
        if self._live is None or self.deadline is None:
            return None
        newest, wall_then, then = self._live
        quiet = now - then
        advanced = wall_then + quiet - settle_seconds
        if advanced < self.deadline or advanced <= newest or quiet < settle_seconds:
            return None
        self._live = (advanced, wall_then, then)
        self.deadline = None  # until the learner sets another: it may take long to get here
        return advanced
