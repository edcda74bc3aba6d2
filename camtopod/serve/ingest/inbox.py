"""Messages from the bus that have not been processed yet."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Container

from camtopod import codec

PUBLISHED_MAX = 1_000
"""Most publications of one camera that wait to be decoded, and most that wait to be released."""

Reply = Callable[[bytes], None]
"""Sends the answer to a request."""
AskedFor = tuple[str, bytes, Reply]
"""A request: camera, content, and what answers it."""


class Inbox:
    """Requests, and publications, in the order of their arrival. Thread-safe; nothing blocks.

    Of requests there is one a camera (`camtopod.serve.outbox`); publications of a camera beyond
    `PUBLISHED_MAX` are dropped. All unknown cameras share the room of one, as names can be
    invented.

    known: the cameras that are known.
    """

    def __init__(self, known: Container[str]) -> None:
        self._known = known
        self._requests: deque[AskedFor] = deque()
        self._published: deque[tuple[str, bytes, str]] = deque()
        """Camera, content, and whose room it takes."""
        self._taken: Counter[str] = Counter()  # number of publications by whose room they take
        self._mutex = threading.Lock()
        self._woken = threading.Event()
        self.dropped: Counter[str] = Counter()
        """Number of publications dropped for lack of room, by camera; "": of unknown ones."""

    def on_request(self, key: str, content: bytes, reply: Reply) -> None:
        """Receive a request on ``store/{camera}``."""
        with self._mutex:
            self._requests.append((key.removeprefix("store/"), content, reply))
            self._woken.set()

    def on_event(self, key: str, content: bytes) -> None:
        """Receive a publication on ``event/{camera}``."""
        camera = key.removeprefix("event/")
        with self._mutex:
            known = camera if camera in self._known else ""
            if self._taken[known] >= PUBLISHED_MAX:
                self.dropped[known] += 1
                return
            self._taken[known] += 1
            self._published.append((camera, content[: codec.EVENT_BYTES_MAX + 1], known))
            self._woken.set()

    def take_request(self) -> AskedFor | None:
        """Return the oldest request, which is then no longer here; None if there is none."""
        return self._requests.popleft() if self._requests else None

    def take_published(self, most: int) -> list[tuple[str, bytes]]:
        """Return up to ``most`` publications (camera, content), which are then no longer here."""
        if not self._published:
            return []
        with self._mutex:
            taken = [self._published.popleft() for _ in range(min(most, len(self._published)))]
            self._taken -= Counter(room for _, _, room in taken)
        return [(camera, content) for camera, content, _ in taken]

    @property
    def has_messages(self) -> bool:
        """True if a message is here."""
        return bool(self._requests or self._published)

    def wait(self, seconds: float) -> None:
        """Wait until a message has come, at most ``seconds``."""
        if not self.has_messages:
            self._woken.wait(seconds)
        self._woken.clear()
