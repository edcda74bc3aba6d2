"""Bounded queues of messages for open pages: filled from any thread, emptied by the connection."""

from __future__ import annotations

import asyncio
import threading
from collections import deque

MESSAGES_MAX = 256
"""Messages that may wait for a page; beyond it the page must fetch everything again."""
BYTES_MAX = 4 << 20
"""Bytes that may wait for a page; beyond it the page must fetch everything again.

A version of a large site is half a megabyte. A single message may be larger than this.
"""
BEAT_SECONDS = 4.0
"""Longest interval between two messages of a stream."""
PAGES_MAX = 64
"""Pages open at a time."""
RESYNC = b"event: resync\ndata: {}\n\n"
"""Message that tells a page to fetch everything again."""


class PageQueue:
    """Queue of one page. Create it and take from it in the event loop's thread.

    camera: the camera whose events the page shows, if any.
    """

    def __init__(self, camera: str | None) -> None:
        self.camera = camera
        self._loop = asyncio.get_running_loop()
        self._mutex = threading.Lock()
        self._messages: deque[bytes] = deque()
        self._bytes = 0
        self._something = asyncio.Event()
        self.closed = False

    def put(self, message: bytes, passing: bool) -> None:
        """Add a message; one that is ``passing`` may be left out. Any thread; never blocks."""
        with self._mutex:
            # Slow pages get fewer of the passing messages.
            if self.closed or (passing and len(self._messages) >= MESSAGES_MAX // 4):
                return

            # Too much is waiting: replace it by a request to fetch everything.
            if len(self._messages) >= MESSAGES_MAX or (
                self._messages and self._bytes + len(message) > BYTES_MAX
            ):
                self._messages.clear()
                self._bytes = 0
                message = RESYNC
            self._messages.append(message)
            self._bytes += len(message)
            self._loop.call_soon_threadsafe(self._something.set)

    def close(self) -> None:
        """Accept no more messages; `take` returns None. Any thread."""
        with self._mutex:
            self.closed = True
            self._loop.call_soon_threadsafe(self._something.set)

    async def take(self, seconds: float) -> bytes | None:
        """Return all waiting messages joined.

        Returns b"" after ``seconds`` without any message, None once closed.
        """
        try:
            await asyncio.wait_for(self._something.wait(), seconds)
        except TimeoutError:
            return b""
        with self._mutex:
            self._something.clear()
            if self.closed:
                return None
            taken = b"".join(self._messages)
            self._messages.clear()
            self._bytes = 0
        return taken


class PageQueues:
    """Queues of all open pages."""

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._queues: set[PageQueue] = set()
        self._closed = False

    def open(self, camera: str | None) -> PageQueue | None:
        """Return a queue for a new page; None if there are `PAGES_MAX` already, or when closing."""
        with self._mutex:
            if self._closed or len(self._queues) >= PAGES_MAX:
                return None
            queue = PageQueue(camera)
            self._queues.add(queue)
            return queue

    def __bool__(self) -> bool:
        """Return True if any page is open."""
        return bool(self._queues)

    def leave(self, queue: PageQueue) -> None:
        """Remove the queue of a closed page."""
        with self._mutex:
            self._queues.discard(queue)

    def send(
        self, name: str, content: bytes, camera: str | None = None, passing: bool = False
    ) -> None:
        """Send a server-sent event to all pages, or to those that show ``camera``.

        content: one line of JSON.
        passing: pages that lag may miss it.
        """
        message = b"event: " + name.encode() + b"\ndata: " + content + b"\n\n"
        with self._mutex:
            queues = [queue for queue in self._queues if camera is None or queue.camera == camera]
        for queue in queues:
            queue.put(message, passing)

    def close(self) -> None:
        """End all connections."""
        with self._mutex:
            self._closed = True
            queues = list(self._queues)
        for queue in queues:
            queue.close()
