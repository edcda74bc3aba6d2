"""``GET /healthz``: does it get on? ``GET /readyz``: can it be relied on? Answered in JSON, 200 or
503. What other pages there are is for the caller to say.

A client gets two seconds and four kilobytes for its request; a few are heard at a time, and whoever
comes then waits until one of them is over. So a client that sends slowly, or nothing, holds nobody
up for long.
"""

from __future__ import annotations

import http.server
import io
import json
import logging
import socket
import socketserver
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from types import MappingProxyType
from typing import Any, NamedTuple

log = logging.getLogger(__name__)

HEAD_BYTES_MAX = 4096
CONNECTION_SECONDS_MAX = 2.0
CONNECTIONS_MAX = 16
REASONS_MAX = 20


class ListenError(OSError):
    """It cannot listen there; ``str()`` says why."""


Reasons = Callable[[], list[str]]
"""Why not; empty if all is well."""


class Page(NamedTuple):
    """An answer."""

    status: HTTPStatus
    content_type: str
    body: bytes


Pages = Mapping[str, Callable[[], Page]]
"""By path."""


class _Handler(http.server.BaseHTTPRequestHandler):
    """One request on a connection."""

    server: _Server
    server_version, sys_version = "camtopod", ""

    def setup(self) -> None:
        """Read the whole head within its limits before anything looks at it."""
        super().setup()
        self.rfile.close()
        self.rfile = io.BytesIO(_head(self.connection))

    def do_GET(self) -> None:
        """The pages there are, and nothing else."""
        asked = self.server.pages.get(self.path.partition("?")[0])
        if asked is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        page = asked()
        self.send_response(page.status)
        self.send_header("Content-Type", page.content_type)
        self.send_header("Content-Length", str(len(page.body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(page.body)

    do_HEAD = do_GET

    def log_message(self, format: str, *args: Any) -> None:
        """Nobody wants a line a second."""
        log.debug(format, *args)


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True
    block_on_close = False
    request_queue_size = 64

    def __init__(self, host: str, port: int, pages: Pages) -> None:
        self.pages = pages
        self._free = threading.BoundedSemaphore(CONNECTIONS_MAX)
        if ":" in host:
            self.address_family = socket.AF_INET6
        super().__init__((host, port), _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """In a thread of its own, as soon as there is one; each ends by its deadline."""
        self._free.acquire()
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """What the thread does."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that has gone is its own business; anything else is ours."""
        error = sys.exception()
        log.log(
            logging.DEBUG if isinstance(error, OSError) else logging.ERROR,
            "the health page: %s",
            error,
            exc_info=error,
        )


def _head(connection: socket.socket) -> bytes:
    """What the client sends up to the empty line; nothing if that is over a limit, which ends the
    connection.
    """
    deadline = time.monotonic() + CONNECTION_SECONDS_MAX
    head = b""
    while b"\r\n\r\n" not in head and b"\n\n" not in head and len(head) < HEAD_BYTES_MAX:
        remaining = deadline - time.monotonic()
        if remaining <= 0:
            return b""
        connection.settimeout(remaining)
        try:
            more = connection.recv(HEAD_BYTES_MAX - len(head))
        except OSError:
            return b""
        if not more:
            return b""
        head += more
    connection.settimeout(CONNECTION_SECONDS_MAX)
    return head if b"\r\n\r\n" in head or b"\n\n" in head else b""


def _judgement(question: Reasons) -> Page:
    reasons = question()[:REASONS_MAX]
    body = (
        json.dumps({"status": "failing" if reasons else "ok", "reasons": reasons}).encode() + b"\n"
    )
    return Page(
        HTTPStatus.SERVICE_UNAVAILABLE if reasons else HTTPStatus.OK, "application/json", body
    )


@contextmanager
def serving(
    listen: str, healthy: Reasons, ready: Reasons, others: Pages = MappingProxyType({})
) -> Iterator[str]:
    """Answer at ``listen`` (host:port, port 0: a free one) while the block runs; gives the address.

    ``listen`` "" means nowhere. ``others``: pages beside /healthz and /readyz. Raises
    `ListenError`.
    """
    if not listen:
        yield ""
        return
    host, _, port = listen.rpartition(":")
    pages = {
        "/healthz": lambda: _judgement(healthy),
        "/readyz": lambda: _judgement(ready),
        **others,
    }
    try:
        made = _Server(host.strip("[]"), int(port), pages)
    except (OSError, OverflowError) as error:
        raise ListenError(f"cannot listen at {listen} ([health] listen): {error}") from None
    with made as server:
        thread = threading.Thread(
            target=server.serve_forever, args=(0.1,), name="health", daemon=True
        )
        thread.start()
        try:
            yield f"{host}:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()
