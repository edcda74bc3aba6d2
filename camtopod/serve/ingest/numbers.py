"""The numbers of each camera's events: which are taken, and which are stored.

A camera's events are numbered (seq) within each boot of its publisher, and come in that order. So
the highest number that was taken tells a repetition from a new event.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence

from camtopod.serve.requests import BOOTS_MAX, Batch

Stream = tuple[str, str]
"""(camera, boot)."""


class Numbers:
    """The highest numbers of each (camera, boot); at most ``streams_max``, those stored last.

    Thread-safe.

    stored: the highest stored number of each stream, in the order of their last entries.
    unknown: streams of which the journal has lost the number and all events.
    """

    def __init__(
        self,
        stored: Mapping[Stream, int],
        unknown: Iterable[Stream] = (),
        streams_max: int = 100_000,
    ) -> None:
        self._mutex = threading.RLock()
        self._stored: dict[str, dict[str, int]] = {}  # those stored last come last
        self._taken: dict[Stream, int] = {}
        self._unknown = set(unknown)
        self._named: dict[str, frozenset[str]] = {}
        self._streams_max = streams_max
        self._streams = 0
        self.lost = 0
        """Number of events that are missing between others, since the start."""
        for (camera, boot), seq in stored.items():
            self.note_stored(camera, boot, seq)

    @property
    def cameras(self) -> list[str]:
        """Cameras that have a stored number, those stored last at the end. Any thread."""
        with self._mutex:
            return list(self._stored)

    def stored(self, camera: str, boot: str) -> int:
        """Return the highest number that is stored; 0 if none is. Any thread."""
        with self._mutex:
            return self._stored.get(camera, {}).get(boot, 0)

    def hello(self, camera: str, boots: Sequence[str]) -> dict[str, int]:
        """Return the highest stored number of each boot that a camera's spool holds.

        Boots of which nothing is known any more are left out.
        """
        self._named[camera] = frozenset(boots)
        known = [boot for boot in boots if (camera, boot) not in self._unknown]
        return {boot: self.stored(camera, boot) for boot in known}

    def take(self, camera: str, batch: Batch) -> list[tuple[int, bytes]] | None:
        """Return the events of a batch that were not taken before, as (seq, bytes).

        None if the batch begins behind events that were never taken.
        """
        with self._mutex:
            # The spool's word counts where the journal has lost its own.
            stream = (camera, batch.boot)
            if stream in self._unknown:
                self._unknown.discard(stream)
                self.note_stored(camera, batch.boot, batch.after)

            taken = max(self._taken.get(stream, 0), self.stored(*stream))
            if batch.after > taken:
                return None
            new = [(seq, raw) for seq, raw in batch.events if seq > taken]
            if new:
                if taken:
                    self.lost += new[-1][0] - taken - len(new)
                self._taken[stream] = new[-1][0]
            return new

    def take_one(self, camera: str, boot: str, seq: int) -> bool:
        """Take a single event; return False if it, or a later one, was taken before."""
        with self._mutex:
            stored = self._stored.get(camera, {}).get(boot, -1)  # publications may count from 0
            if seq <= max(self._taken.get((camera, boot), -1), stored):
                return False
            self._taken[camera, boot] = seq
            return True

    def note_stored(self, camera: str, boot: str, seq: int) -> None:
        """Note that all events of a stream up to ``seq`` that were taken are stored."""
        with self._mutex:
            boots = self._stored.setdefault(camera, {})
            if boot not in boots:
                self._streams += 1
            elif next(reversed(boots)) != boot:
                boots[boot] = boots.pop(boot)
            if next(reversed(self._stored)) != camera:
                self._stored[camera] = self._stored.pop(camera)
            boots[boot] = max(seq, boots.get(boot, 0))
            if self._taken.get((camera, boot), 0) <= seq:
                self._taken.pop((camera, boot), None)

    def forget_surplus(self, camera: str) -> list[str]:
        """Forget boots that can be missed, the oldest first, and return them.

        They are those beyond `BOOTS_MAX` of this camera that its spool does not hold.
        """
        with self._mutex:
            boots = self._stored.get(camera, {})
            named = self._named.get(camera, frozenset())
            too_many = max(0, len(boots) - BOOTS_MAX)
            surplus = [boot for boot in boots if boot not in named][:too_many]
            for boot in surplus:
                del boots[boot]
            self._streams -= len(surplus)

            # Too many streams in all: whole cameras go, those stored longest ago.
            while self._streams > self._streams_max:
                other = next(iter(self._stored))
                self._streams -= len(self._stored.pop(other))
                self._named.pop(other, None)
            return surplus
