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
    """A queue; `take` and `done` are called from one thread, `put` from one at a time."""

    def __init__(self) -> None:
        self._ready: queue.SimpleQueue[Received] = queue.SimpleQueue()
        self._put_count = self._stored_count = self._batch_size = 0
        self._is_closed = False

    @property
    def waiting(self) -> int:
        """Number of events that are not stored yet."""
        return self._put_count - self._stored_count

    @property
    def is_finished(self) -> bool:
        """True if nothing is there and nothing will come."""
        return self._is_closed and self._ready.empty()

    def put(self, ready: Sequence[Received]) -> None:
        """Append events."""
        self._put_count += len(ready)
        for item in ready:
            self._ready.put(item)

    def close(self) -> None:
        """Close the queue: nothing more will come."""
        self._is_closed = True

    def take(self, limit: int, seconds: float, more_seconds: float) -> list[Received]:
        """Return up to ``limit`` events; they count as waiting until `done`.

        seconds: longest wait for the first event.
        more_seconds: further wait for others.
        """
        batch: list[Received] = []
        with contextlib.suppress(queue.Empty):
            batch.append(self._ready.get(timeout=seconds))
            if self._ready.qsize() < limit and not self._is_closed:
                time.sleep(more_seconds)
            while len(batch) < limit:
                batch.append(self._ready.get_nowait())
        self._batch_size = len(batch)
        return batch

    def done(self) -> None:
        """Note that the events taken are stored."""
        self._stored_count += self._batch_size
