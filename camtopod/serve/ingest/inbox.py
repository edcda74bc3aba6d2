"""What came in and is not yet stored: a queue for each camera, emptied in turns, so that a flood
waits behind itself.

Cameras never stored before share one queue, so a flood of made-up names has one camera's turn. When
everything together is too much, it is the longest queue that loses its newest: what a spool has is
pulled again later.
"""

from __future__ import annotations

import collections
import threading
from collections.abc import Callable, Sequence
from operator import itemgetter

from msgspec import Struct

STRANGERS = ""
"""The queue of cameras that are not known; no camera is called so."""


class Message(Struct, frozen=True, gc=False):
    """A publication on ``event/{camera}``; ``box``: whose clock has stamped it, "" if its publisher
    does not say.
    """

    camera: str
    raw: bytes
    box: str = ""


class Inbox:
    """`put` never blocks and may be called from any thread; `take` from one.

    ``known(camera)``: whether it has a queue of its own. At most ``events_max`` wait,
    ``camera_events_max`` of them in one queue; ``quantum`` is what a queue gives in its turn.
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
        self._queues: dict[
            str, collections.deque[tuple[int, Message]]
        ] = {}  # by whose turn it is; none is empty
        self._waiting = 0
        self._arrived = 0
        self._changed = threading.Condition()
        self.dropped: collections.Counter[str] = collections.Counter()
        """Messages there was no room for, by queue."""

    def put(self, message: Message) -> None:
        """Let it wait for its turn, or drop it, or the newest of a longer queue."""
        with self._changed:
            self._put(message)
            self._changed.notify()

    def put_all(self, messages: Sequence[Message]) -> None:
        """The same of several, of which `wait` need not know."""
        with self._changed:
            for message in messages:
                self._put(message)

    def _put(self, message: Message) -> None:
        name = message.camera
        queue = self._queues.get(name)
        if queue is None and not self._known(name):
            name, queue = STRANGERS, self._queues.get(STRANGERS)
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

    def poke(self) -> None:
        """Let `wait` return."""
        with self._changed:
            self._changed.notify()

    def wait(self, seconds: float) -> None:
        """Until something comes or `poke` is called, at most ``seconds``."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(seconds)

    def take(self, most: int) -> list[Message]:
        """Up to ``most`` messages, chosen in turns; in the order they came, or else quick cameras
        would be late.
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
