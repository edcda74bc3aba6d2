"""The queue of ready events between the ordering and the storing thread.

So a slow disk does not delay predictions.
"""

from __future__ import annotations

import contextlib
import queue
import time
from collections.abc import Sequence

from camtopod.serve.ingest.received import Received


class StoreQueue:
    """A queue; `take` and `done` are called from one thread, the others from any."""

    def __init__(self) -> None:
        self._ready: queue.SimpleQueue[Received] = queue.SimpleQueue()
        self._taken = 0
        self._ended = False

    @property
    def waiting(self) -> int:
        """Number of events that are not stored yet."""
        return self._ready.qsize() + self._taken

    @property
    def is_finished(self) -> bool:
        """True if nothing is there and nothing will come."""
        return self._ended and self._ready.empty()

    def put(self, ready: Sequence[Received]) -> None:
        """Append events."""
        for received in ready:
            self._ready.put(received)

    def close(self) -> None:
        """Close the queue: nothing more will come."""
        self._ended = True

    def take(self, most: int, seconds: float, more_seconds: float) -> list[Received]:
        """Return up to ``most`` events; they count as waiting until `done`.

        seconds: longest wait for the first event.
        more_seconds: further wait for others.
        """
        taken: list[Received] = []
        with contextlib.suppress(queue.Empty):
            taken.append(self._ready.get(timeout=seconds))
            if self._ready.qsize() < most and not self._ended:
                time.sleep(more_seconds)
            while len(taken) < most:
                taken.append(self._ready.get_nowait())
        self._taken = len(taken)
        return taken

    def done(self) -> None:
        """Note that the events taken are stored."""
        self._taken = 0
