"""What is ready and not yet stored, on its way from the thread that orders to the one that stores,
so that a disk that is slow holds up no prediction.
"""

from __future__ import annotations

import collections
import threading
import time
from collections.abc import Sequence

from camtopod.serve.ingest.camera_registry import Received


class Handover:
    """`put` and `end` from one thread, `take` and `done` from another."""

    def __init__(self) -> None:
        self._ready: collections.deque[Received] = collections.deque()
        self._taken = 0
        self._changed = threading.Condition()
        self._ended = False

    @property
    def waiting(self) -> int:
        """Not yet stored."""
        return len(self._ready) + self._taken

    @property
    def over(self) -> bool:
        """Nothing is there and nothing will come."""
        return self._ended and not self._ready

    def begin(self) -> None:
        """From now on something may come."""
        self._ended = False

    def put(self, ready: Sequence[Received]) -> None:
        """Behind what waits."""
        with self._changed:
            self._ready.extend(ready)
            self._changed.notify_all()

    def end(self) -> None:
        """Nothing more will come."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def take(self, most: int, seconds: float, more_seconds: float) -> list[Received]:
        """Up to ``most`` that wait, or that come within ``seconds`` and ``more_seconds`` after the
        first; they count until `done`.
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
        """What was taken is stored."""
        with self._changed:
            self._taken = 0
            self._changed.notify_all()

    def wait_for_room(self, seconds: float) -> None:
        """Until something is stored, at most ``seconds``."""
        with self._changed:
            self._changed.wait(seconds)
