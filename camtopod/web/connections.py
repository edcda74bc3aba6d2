"""HTTP connections with a deadline for each request, of which the newest always find a place."""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS_MAX = 1_024
"""Open connections."""
REQUEST_SECONDS = 10.0
"""Time that a request has until all of it is there, from the connection or the response before."""


class HttpConnection(H11Protocol):
    """One connection; if too many are open, it takes the place of the one that waits longest.

    A connection waits while its request is not whole, or its client does not read.
    """

    _since = 0.0
    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Make room, and wait for the first request."""
        if len(self.connections) >= CONNECTIONS_MAX:
            peers: list[Any] = [*self.connections]
            candidates = (peer for peer in peers if peer.flow.write_paused or not peer.has_request)
            oldest = min(candidates, key=lambda peer: peer._since, default=self)
            (transport if oldest is self else oldest.transport).abort()
            self.connections.discard(oldest)
        super().connection_made(transport)
        self._since = self.loop.time()
        self._expect()

    def data_received(self, data: bytes) -> None:
        """Take a part of a request."""
        super().data_received(data)
        self._expect()

    def on_response_complete(self) -> None:
        """Wait for the next request, a part of which may be here already."""
        super().on_response_complete()
        self._expect()

    @property
    def has_request(self) -> bool:
        """True from the end of a request to that of its response."""
        return self.conn.their_state not in (h11.IDLE, h11.SEND_BODY)

    def _expect(self) -> None:
        """Give a request its time, unless it is whole."""
        if self._deadline is not None and self.has_request:
            self._deadline.cancel()
            self._deadline = None
        elif self._deadline is None and not self.has_request:
            self._deadline = self.loop.call_later(REQUEST_SECONDS, self.transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadline."""
        if self._deadline is not None:
            self._deadline.cancel()
        super().connection_lost(exc)
