"""What waits for one open page: messages from any thread, taken by the page's connection, within a
limit.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque

MESSAGES_MAX = 256
BYTES_MAX = 4 << 20
"""Messages, and bytes, that wait for a page; beyond it the page is told to fetch everything anew. A
version of a large site is half a megabyte; one that alone is more may wait alone.
"""
PASSING_MAX = 64
"""Predictions and events are left out while this many messages wait: a page that lags shows fewer
of them.
"""
PAGES_MAX = 64
"""Pages that are open at a time."""
RESYNC = b"event: resync\ndata: {}\n\n"


class Mailbox:
    """One page's. ``camera``: whose events it wants to see, if any. Made and taken from in the
    event loop's thread.
    """

    def __init__(self, camera: str | None) -> None:
        self.camera = camera
        self.left_out = 0
        """Passing messages that the page did not get."""
        self._loop = asyncio.get_running_loop()
        self._mutex = threading.Lock()
        self._messages: deque[bytes] = deque()
        self._bytes = 0
        self._something = asyncio.Event()
        self._told = False
        self.closed = False

    def put(self, message: bytes, passing: bool) -> None:
        """Add a message; one that is ``passing`` may be left out. Any thread, never blocks."""
        with self._mutex:
            if self.closed:
                return
            if passing and len(self._messages) >= PASSING_MAX:
                self.left_out += 1
                return
            if len(self._messages) >= MESSAGES_MAX or (
                self._messages and self._bytes + len(message) > BYTES_MAX
            ):
                self._messages.clear()
                self._bytes = 0
                message = RESYNC
            self._messages.append(message)
            self._bytes += len(message)
            self._wake()

    def close(self) -> None:
        """No more messages; `take` returns None. Any thread."""
        with self._mutex:
            self.closed = True
            self._wake()

    async def take(self, seconds: float) -> bytes | None:
        """Everything that waits as one; b"" when nothing came within ``seconds``; None once
        closed.
        """
        try:
            await asyncio.wait_for(self._something.wait(), seconds)
        except TimeoutError:
            return b""
        with self._mutex:
            self._something.clear()
            self._told = False
            if self.closed:
                return None
            taken = b"".join(self._messages)
            self._messages.clear()
            self._bytes = 0
        return taken

    def _wake(self) -> None:
        if not self._told:
            self._told = True
            self._loop.call_soon_threadsafe(self._something.set)


class Hub:
    """The mailboxes of all open pages."""

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._boxes: set[Mailbox] = set()
        self._closed = False

    def open(self, camera: str | None) -> Mailbox | None:
        """A mailbox for a page that has come; None if there are `PAGES_MAX` already, or it is
        closing.
        """
        with self._mutex:
            if self._closed or len(self._boxes) >= PAGES_MAX:
                return None
            box = Mailbox(camera)
            self._boxes.add(box)
            return box

    def leave(self, box: Mailbox) -> None:
        """The page has gone."""
        with self._mutex:
            self._boxes.discard(box)

    def tell(
        self, name: str, content: bytes, camera: str | None = None, passing: bool = False
    ) -> None:
        """Send a server-sent event of one line of JSON to all pages, or to those that look at
        ``camera``.
        """
        message = b"event: " + name.encode() + b"\ndata: " + content + b"\n\n"
        with self._mutex:
            boxes = [box for box in self._boxes if camera is None or box.camera == camera]
        for box in boxes:
            box.put(message, passing)

    def close(self) -> None:
        """End all connections."""
        with self._mutex:
            self._closed = True
            boxes = list(self._boxes)
        for box in boxes:
            box.close()
