"""Messages from the bus that have not been processed yet."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Container

from camtopod import codec

PUBLISHED_MAX = 1_000
"""Most publications of one camera that wait to be decoded, and most that wait to be released."""

Reply = Callable[[bytes], None]
"""Sends the answer to a request."""
Message = tuple[str, bytes, Reply | None]
"""(camera, content, what answers it; None for a publication)."""


class Inbox:
    """Requests and publications, in the order of their arrival. Thread-safe; nothing blocks.

    Of requests there is one a camera (`camtopod.serve.outbox`); publications of a camera beyond
    `PUBLISHED_MAX` are dropped. All unknown cameras share the room of one, as names can be
    invented.

    known: the cameras that are known.
    """

    def __init__(self, known: Container[str]) -> None:
        self._known = known
        self._messages: list[Message] = []
        self._published: Counter[str] = Counter()  # publications among them, by camera
        self._mutex = threading.Lock()
        self._woken = threading.Event()
        self.dropped: Counter[str] = Counter()
        """Number of publications dropped for lack of room, by camera; "": of unknown ones."""

    def on_request(self, key: str, content: bytes, reply: Reply) -> None:
        """Receive a request on ``store/{camera}``."""
        with self._mutex:
            self._messages.append((key.removeprefix("store/"), content, reply))
            self._woken.set()

    def on_event(self, key: str, content: bytes) -> None:
        """Receive a publication on ``event/{camera}``."""
        camera = key.removeprefix("event/")
        with self._mutex:
            known = camera if camera in self._known else ""
            self._published[known] += 1
            if self._published[known] > PUBLISHED_MAX:
                self.dropped[known] += 1
                return
            self._messages.append((camera, content[: codec.EVENT_BYTES_MAX + 1], None))
            self._woken.set()

    def take(self) -> list[Message]:
        """Return all messages and empty the inbox."""
        with self._mutex:
            messages = self._messages
            self._messages = []
            self._published.clear()
        return messages

    @property
    def has_messages(self) -> bool:
        """True if a message has come since the last `take`."""
        return bool(self._messages)

    def wake(self) -> None:
        """End the present or the next `wait`, as something else may go on now."""
        self._woken.set()

    def wait(self, seconds: float) -> None:
        """Wait until a message has come, at most ``seconds``."""
        self._woken.wait(seconds)
        self._woken.clear()
