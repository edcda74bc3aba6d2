"""HTTP connections with deadlines, and log messages about clients at most once a minute."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable
from operator import itemgetter

from uvicorn.protocols.http.h11_impl import H11Protocol

log = logging.getLogger(__name__)

WAITING_MAX = 64
"""Connections without a complete request; beyond it the oldest ones are closed.

Only connections that have waited for longer than `GRACE_SECONDS` are closed.
"""
GRACE_SECONDS = 1.0
"""Time for which a waiting connection is not closed: a request under way arrives within it."""
REQUEST_SECONDS = 10.0
"""Time after which a connection without a complete request is closed."""
SEND_TIMEOUT_SECONDS = 30.0
"""Time after which a client that accepts no data is disconnected."""
LOG_SECONDS = 60.0
"""Shortest interval between two equal log messages about clients."""


class Seldom(logging.Filter):
    """Log filter that passes each message once in `LOG_SECONDS`, with the number
    suppressed.
    """

    def __init__(self) -> None:
        super().__init__()
        self._said: dict[str, tuple[float, int]] = {}
        """By message: time when it last passed, and how many were suppressed since."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Return True if the message is to be logged."""
        now = time.monotonic()
        said, meanwhile = self._said.get(record.msg, (-math.inf, 0))
        if now - said < LOG_SECONDS:
            self._said[record.msg] = said, meanwhile + 1
            return False
        self._said[record.msg] = now, 0
        if meanwhile:
            record.msg += f" ({meanwhile} more since the last such message)"
        return True


class Connection(H11Protocol):
    """HTTP connection with deadlines, so that idle or slow clients do not block others."""

    waiting_since: float | None = None
    """Time since when it waits for a request (seconds of the event loop); None while answering."""
    _timer: asyncio.TimerHandle | None = None
    """Deadline of the request, or of the client's next read."""
    _unsent = 0
    """Bytes that the client had not accepted when the timer was set."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for a request."""
        super().connection_made(transport)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the timer."""
        self._stop_waiting()
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Process received data, which may be a request or a part of one."""
        super().handle_events()
        if self.waiting_since is not None and self._answering:
            self._stop_waiting()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        if not self._answering and not self.transport.is_closing():
            self._wait()

    def pause_writing(self) -> None:
        """Begin to watch a client that accepts less than it is sent."""
        super().pause_writing()
        self._watch_taking()

    def resume_writing(self) -> None:
        """Stop watching: the client has caught up."""
        super().resume_writing()
        if self.waiting_since is None and not self.transport.is_closing():
            self._set_timer(None)

    @property
    def _answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _wait(self) -> None:
        """Wait for a request, and close the oldest waiting connections if there are too many."""
        self.waiting_since = now = self.loop.time()
        self._set_timer(REQUEST_SECONDS, self._give_up)
        waiting = [
            one
            for one in self.connections
            if isinstance(one, Connection) and one.waiting_since is not None
        ]
        old = [
            (one.waiting_since or now, one)
            for one in waiting
            if (one.waiting_since or now) < now - GRACE_SECONDS
        ]
        for _, one in sorted(old, key=itemgetter(0))[: max(0, len(waiting) - WAITING_MAX)]:
            one._give_up()

    def _stop_waiting(self) -> None:
        self.waiting_since = None
        self._set_timer(None)

    def _give_up(self) -> None:
        """Close without a request; earlier responses are still sent."""
        self._stop_waiting()
        if not self.transport.is_closing():
            log.warning(
                "a client was disconnected: it sent no complete request in time, "
                "or too many clients are waiting"
            )
            self.transport.close()
        self._watch_taking()

    def _watch_taking(self) -> None:
        """Start the deadline for the client to accept data."""
        self._unsent = self.transport.get_write_buffer_size()
        self._set_timer(SEND_TIMEOUT_SECONDS, self._look_at_taking)

    def _look_at_taking(self) -> None:
        """Continue if the client has accepted data, else disconnect it."""
        if self.transport.get_write_buffer_size() < self._unsent:
            self._watch_taking()
        else:
            self.transport.abort()

    def _set_timer(self, seconds: float | None, then: Callable[[], None] = lambda: None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None if seconds is None else self.loop.call_later(seconds, then)
