"""How far each stream is stored, and the saying so: at intervals, of those that have got further since."""

from __future__ import annotations

import collections
from collections.abc import Callable, Iterable

from camtopod.records import Ack
from camtopod.serve.bus import Bus
from camtopod.serve.cameras import Received
from camtopod.serve.progress import Beat
from camtopod.serve.streams import Key


class Acks:
    """``stored``: as `Journal.streams`. ``owns``: the cameras whose events it is for this daemon to acknowledge.
    `again` and `forget` from one thread at a time, `note` and `put` from another.
    """

    def __init__(self, bus: Bus, stored: dict[Key, int], owns: Callable[[str], bool]) -> None:
        self._bus, self._owns = bus, owns
        self.stored = stored
        """The highest seq of each stream that is stored."""
        self._dirty = set(stored)
        self._again: collections.deque[Key] = collections.deque()
        self._forgotten: collections.deque[Key] = collections.deque()
        self._next = 0.0

    def note(self, ready: Iterable[Received]) -> None:
        """These are stored."""
        further = {
            (entry.camera, entry.boot): entry.seq
            for entry in (received.entry for received in ready)
            if entry.boot is not None and entry.seq is not None
        }
        self.stored.update(further)
        self._dirty.update(further)

    def again(self, key: Key) -> None:
        """The ack of a stream got lost."""
        self._again.append(key)

    def forget(self, keys: Iterable[Key]) -> None:
        """Streams that are not followed any more."""
        self._forgotten.extend(keys)

    def put(self, now: float, interval: float, beat: Beat) -> None:
        """Unless that was less than ``interval`` seconds ago; ``now`` is of a clock that never steps."""
        if now < self._next:
            return
        self._next = now + interval
        while self._again:
            key = self._again.popleft()
            if key in self.stored:
                self._dirty.add(key)
        for camera, boot in self._dirty:
            if self._owns(camera):
                self._bus.put(f"ack/{camera}", Ack(camera, boot, self.stored[camera, boot]), "ack")
                beat()  # a put onto a dead link blocks for seconds
        self._dirty.clear()
        while self._forgotten:
            self.stored.pop(self._forgotten.popleft(), None)
