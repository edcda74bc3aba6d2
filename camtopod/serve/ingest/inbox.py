"""The inbox of received events: one queue for each camera, emptied in turns.

So a flooding camera delays only itself. Cameras that were never stored share one queue, so a flood
of invented names gets the turn of one camera. When all queues together are too long, the longest
one loses its newest event; it is pulled from the spool later.
"""

from __future__ import annotations

import collections
import threading
from collections.abc import Callable, Sequence
from operator import itemgetter

from msgspec import Struct

UNKNOWN_CAMERAS = ""
"""Name of the queue of unknown cameras; no camera has this name."""


class Message(Struct, frozen=True, gc=False):
    """A publication on ``event/{camera}``.

    box: the box whose clock has stamped it; "" if its publisher does not say.
    """

    camera: str
    raw: bytes
    box: str = ""


class Inbox:
    """Events that wait to be put in order; `put` may be called from any thread, `take` from one.

    `put` never blocks.

    events_max, camera_events_max: most events in all queues, and in one queue.
    quantum: events that a queue gives in its turn.
    known: tells whether a camera has a queue of its own.
    """

    def __init__(
        self, events_max: int, camera_events_max: int, quantum: int, known: Callable[[str], bool]
    ) -> None:
        self._events_max, self._camera_events_max, self._quantum = (
            events_max,
            camera_events_max,
            quantum,
        )
        self._known = known
        # In the order of their turns; none is empty.
        self._queues: dict[str, collections.deque[tuple[int, Message]]] = {}
        self._waiting = 0
        self._arrived = 0
        self._changed = threading.Condition()
        self.dropped: collections.Counter[str] = collections.Counter()
        """Number of messages dropped for lack of room, by queue."""

    def put(self, message: Message) -> None:
        """Add a message; if there is no room, drop it or the newest of a longer queue."""
        with self._changed:
            self._put(message)
            self._changed.notify()

    def put_all(self, messages: Sequence[Message]) -> None:
        """Add messages without waking `wait`."""
        with self._changed:
            for message in messages:
                self._put(message)

    def _put(self, message: Message) -> None:
        # Choose the queue.
        name = message.camera
        queue = self._queues.get(name)
        if queue is None and not self._known(name):
            name, queue = UNKNOWN_CAMERAS, self._queues.get(UNKNOWN_CAMERAS)

        # Make room if another queue is longer.
        length = 0 if queue is None else len(queue)
        room = length < self._camera_events_max
        if room and self._waiting >= self._events_max:
            longest = max(self._queues, key=lambda other: len(self._queues[other]))
            room = len(self._queues[longest]) > length + 1
            if room:
                self._queues[longest].pop()
                self._waiting -= 1
                self.dropped[longest] += 1
        if not room:
            self.dropped[name] += 1
            return
        if queue is None:
            queue = self._queues[name] = collections.deque()
        queue.append((self._arrived, message))
        self._arrived += 1
        self._waiting += 1

    def wake(self) -> None:
        """Let `wait` return."""
        with self._changed:
            self._changed.notify()

    def wait(self, seconds: float) -> None:
        """Wait until a message comes or `wake` is called, at most ``seconds``."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(seconds)

    def take(self, most: int) -> list[Message]:
        """Return up to ``most`` messages, chosen in turns, in the order in which they came.

        In the order of turns, the events of fast cameras would be late.
        """
        taken: list[tuple[int, Message]] = []
        with self._changed:
            while len(taken) < most and self._queues:
                name = next(iter(self._queues))
                queue = self._queues.pop(name)
                taken += [
                    queue.popleft()
                    for _ in range(min(self._quantum, most - len(taken), len(queue)))
                ]
                if queue:
                    self._queues[name] = queue  # behind the others
            self._waiting -= len(taken)
        taken.sort(key=itemgetter(0))
        return [message for _, message in taken]

    def __len__(self) -> int:
        return self._waiting
