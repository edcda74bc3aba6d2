"""Notice that a camera makes more events than people do."""

from __future__ import annotations

from collections import deque

from camtopod.records import Event

EVENTS_PER_MINUTE_MAX = 120
"""Events that people make within a minute at most: each second one enters and one leaves."""
_MINUTE_SECONDS = 60.0


class EventRate:
    """Counts one camera's events."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=EVENTS_PER_MINUTE_MAX + 1)
        self._told = False

    def too_high(self, event: Event) -> bool:
        """Count an event; return True, once, if there are more of them than people make."""
        self._times.append(event.t)
        full = len(self._times) > EVENTS_PER_MINUTE_MAX
        if self._told or not full or max(self._times) - min(self._times) >= _MINUTE_SECONDS:
            return False
        self._told = True
        return True
