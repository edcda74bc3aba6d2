"""The numbers of each camera's events: which are taken, and which are stored.

A camera's events are numbered (seq) within each boot of its publisher, and come in that order. So
the highest number that was taken tells a repetition from a new event.

A boot of which nothing is known is taken from the beginning. That counts nothing twice: the journal
skips what it has, and what it has deleted is too late to be learned.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping

from camtopod.serve.requests import Batch
from camtopod.serve.storage import STREAMS_KEPT_MAX, Stream


class Numbers:
    """The highest numbers of each (camera, boot); at most `STREAMS_KEPT_MAX`, those stored last.

    Thread-safe.

    numbers: the highest stored number of each stream, in the order of their last entries.
    """

    def __init__(self, numbers: Mapping[Stream, int]) -> None:
        self._mutex = threading.Lock()
        self._disk_numbers = dict(numbers)
        self._memory_numbers: dict[Stream, int] = {}  # numbers that are not stored yet
        self.loss = 0
        """Number of events that are missing between others, since the start."""

    @property
    def cameras(self) -> list[str]:
        """Cameras that have a stored number, those stored last at the end. Any thread."""
        with self._mutex:
            return list(dict.fromkeys(camera for camera, _ in reversed(self._disk_numbers)))[::-1]

    def stored(self, camera: str, boot: str) -> int:
        """Return the highest number that is stored; 0 if none is. Any thread."""
        return self._disk_numbers.get((camera, boot), 0)

    def take(self, camera: str, batch: Batch) -> list[tuple[int, bytes]] | None:
        """Return the events of a batch that were not taken before, as (seq, bytes).

        None if the batch begins behind events that were never taken.
        """
        with self._mutex:
            stream = (camera, batch.boot)
            top = max(self._memory_numbers.get(stream, 0), self._disk_numbers.get(stream, 0))
            if batch.after > top:
                return None
            new = [(seq, raw) for seq, raw in batch.events if seq > top]
            if new:
                before = top or new[0][0] - 1  # a boot may begin with any number
                self.loss += new[-1][0] - before - len(new)
                self._memory_numbers[stream] = new[-1][0]
            return new

    def take_one(self, camera: str, boot: str, seq: int) -> bool:
        """Take a single event; return False if it, or a later one, was taken before."""
        with self._mutex:
            stream = (camera, boot)
            # Publications may count from 0.
            is_new = seq > max(
                self._memory_numbers.get(stream, -1), self._disk_numbers.get(stream, -1)
            )
            if is_new:
                self._memory_numbers[stream] = seq
            return is_new

    def note_stored(self, camera: str, boot: str, seq: int) -> None:
        """Note that all events of a stream up to ``seq`` that were taken are stored."""
        with self._mutex:
            stream = (camera, boot)
            self._disk_numbers[stream] = max(seq, self._disk_numbers.pop(stream, 0))  # at the end
            if self._memory_numbers.get(stream, 0) <= seq:
                self._memory_numbers.pop(stream, None)
            if len(self._disk_numbers) > STREAMS_KEPT_MAX:
                del self._disk_numbers[next(iter(self._disk_numbers))]
