"""The queue of ready events between the ordering and the storing thread.

So a slow disk does not delay predictions.
"""

from __future__ import annotations

import collections
import threading
import time
from collections.abc import Sequence

from camtopod.serve.ingest.received import Received


class StoreQueue:
    """A queue; `take` and `done` are called from one thread, the others from any."""

    def __init__(self) -> None:
        self._ready: collections.deque[Received] = collections.deque()
        self._taken = 0
        self._changed = threading.Condition()
        self._ended = False

    @property
    def waiting(self) -> int:
        """Number of events that are not stored yet."""
        return len(self._ready) + self._taken

    @property
    def is_finished(self) -> bool:
        """True if nothing is there and nothing will come."""
        return self._ended and not self._ready

    def put(self, ready: Sequence[Received]) -> None:
        """Append events."""
        with self._changed:
            self._ready.extend(ready)
            self._changed.notify_all()

    def close(self) -> None:
        """Close the queue: nothing more will come."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def take(self, most: int, seconds: float, more_seconds: float) -> list[Received]:
        """Return up to ``most`` events; they count as waiting until `done`.

        seconds: longest wait for the first event.
        more_seconds: further wait for others.
        """
        with self._changed:
            if not self._ready and not self._ended:
                self._changed.wait(seconds)
        if 0 < len(self._ready) < most and not self._ended:
            time.sleep(more_seconds)
        with self._changed:
            self._taken = min(most, len(self._ready))
            return [self._ready.popleft() for _ in range(self._taken)]

    def done(self) -> None:
        """Note that the events taken are stored."""
        with self._changed:
            self._taken = 0
            self._changed.notify_all()
