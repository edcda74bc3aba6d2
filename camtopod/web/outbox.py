"""Bounded queues of messages for open pages: filled from any thread, emptied by the connection."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

MESSAGES_MAX = 256
"""Messages that may wait for a page; beyond it the connection ends, and the page comes back."""
BEAT_SECONDS = 4.0
"""Longest interval between two messages of a stream."""
PAGES_MAX = 64
"""Pages open at a time."""


def message(name: str, content: bytes) -> bytes:
    """Return a server-sent event; ``content`` is one line of JSON.

    name: "" for an event without one, which browsers give to ``onmessage``.
    """
    head = f"event: {name}\n" if name else ""
    return head.encode() + b"data: " + content + b"\n\n"


class PageQueue:
    """Queue of one page. Create it and take from it in the event loop's thread.

    camera: as in `PageQueues.send`.
    """

    def __init__(self, camera: str | None = None) -> None:
        self.camera = camera
        self._loop = asyncio.get_running_loop()
        self._messages: asyncio.Queue[bytes | None] = asyncio.Queue()
        self.is_full = False
        """True once too many messages have waited, so that the stream ends."""

    def put(self, message: bytes, is_optional: bool) -> None:
        """Add a message; an optional one may be left out. Any thread; never blocks."""
        self._loop.call_soon_threadsafe(self._put, message, is_optional)

    def close(self) -> None:
        """End the stream after the messages that wait. Any thread."""
        self._loop.call_soon_threadsafe(self._messages.put_nowait, None)

    async def take(self) -> bytes | None:
        """Return the next message.

        Returns b"" after `BEAT_SECONDS` without one, None at the end of the stream.
        """
        try:
            message = await asyncio.wait_for(self._messages.get(), BEAT_SECONDS)
        except TimeoutError:
            message = b""
        return None if self.is_full else message

    def _put(self, message: bytes, is_optional: bool) -> None:
        """Add a message; a slow page gets fewer of the optional ones."""
        length = self._messages.qsize()
        if length >= MESSAGES_MAX:
            self.is_full = True
        elif not is_optional or length < MESSAGES_MAX // 4:
            self._messages.put_nowait(message)


class PageQueues:
    """Queues of all open pages."""

    def __init__(self) -> None:
        self._queues: set[PageQueue] = set()
        self._is_closed = False

    @property
    def is_any_open(self) -> bool:
        """True while there is a page."""
        return bool(self._queues)

    def open(self, camera: str | None = None) -> PageQueue | None:
        """Return a queue for a new page; None if there are `PAGES_MAX` already, or when closing.

        camera: as in `send`.
        """
        # A page that has stopped reading does not end its stream, but it keeps no other out.
        self._queues -= {queue for queue in self._queues if queue.is_full}
        if self._is_closed or len(self._queues) >= PAGES_MAX:
            return None
        queue = PageQueue(camera)
        self._queues.add(queue)
        return queue

    async def messages(self, queue: PageQueue, beat: Callable[[], bytes]) -> AsyncIterator[bytes]:
        """Yield the messages to a page until it leaves; ``beat`` makes one when there is none."""
        try:
            while (message := await queue.take()) is not None:
                yield message or beat()
        finally:
            self._queues.discard(queue)

    def send(
        self, name: str, content: bytes, camera: str | None = None, is_optional: bool = False
    ) -> None:
        """Send a server-sent event to all pages, or to those opened for ``camera``.

        content: one line of JSON.
        is_optional: pages that lag may miss it.
        """
        for queue in tuple(self._queues):
            if camera is None or queue.camera == camera:
                queue.put(message(name, content), is_optional)

    def close(self) -> None:
        """End all connections."""
        self._is_closed = True
        for queue in tuple(self._queues):
            queue.close()
