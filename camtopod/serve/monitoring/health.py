"""Serve ``GET /healthz`` (does every loop make progress?) and ``GET /readyz`` (is it ready?).

The answer is JSON with status 200 or 503. The caller can add further pages. A client has two
seconds and four kilobytes for its request; a few requests are served at a time, and further clients
wait until one of them ends. So a client that sends slowly or nothing delays others only briefly.
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
"""Largest request, in bytes."""
CONNECTION_SECONDS_MAX = 2.0
"""Longest time for a client to send its request, in seconds; also for taking the answer."""
CONNECTIONS_MAX = 16
"""Most requests served at a time."""
REASONS_MAX = 20
"""Most reasons in an answer."""


class ListenError(OSError):
    """The address cannot be listened on; ``str()`` says why."""


Reasons = Callable[[], list[str]]
"""Function that returns the reasons against "yes"; none if all is well."""


class Page(NamedTuple):
    """An answer."""

    status: HTTPStatus
    content_type: str
    body: bytes


Pages = Mapping[str, Callable[[], Page]]
"""Functions that make the pages, by path."""


class _Handler(http.server.BaseHTTPRequestHandler):
    """One request on one connection."""

    server: _Server
    server_version, sys_version = "camtopod", ""

    def setup(self) -> None:
        """Read the whole request within its limits before it is parsed."""
        super().setup()
        self.rfile.close()
        self.rfile = io.BytesIO(_head(self.connection))

    def do_GET(self) -> None:
        """Answer with the page at the path, or with 404; both `/` and 404 list the pages."""
        path = self.path.partition("?")[0]
        asked = self.server.pages.get(path)
        page = _contents(self.server.pages, path) if asked is None else asked()
        self.send_response(page.status)
        self.send_header("Content-Type", page.content_type)
        self.send_header("Content-Length", str(len(page.body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(page.body)

    do_HEAD = do_GET

    def log_message(self, format: str, *args: Any) -> None:
        """Log at level debug, as there may be a request every second."""
        log.debug(format, *args)


class _Server(socketserver.ThreadingTCPServer):
    """A server with one thread for each of at most `CONNECTIONS_MAX` requests."""

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
        """Wait for a free slot, then serve the request in a new thread, which has a deadline."""
        self._free.acquire()
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve one request, in its thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log an error; at level debug if a client has disconnected."""
        error = sys.exception()
        log.log(
            logging.DEBUG if isinstance(error, OSError) else logging.ERROR,
            "the health page: %s",
            error,
            exc_info=error,
        )


def _head(connection: socket.socket) -> bytes:
    """Return the bytes of the request up to the empty line; b"" if a limit is exceeded.

    Then the connection is closed.
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


def _contents(pages: Pages, path: str) -> Page:
    """Return the page that lists all pages; with status 404 if another one was asked for."""
    status = HTTPStatus.OK if path == "/" else HTTPStatus.NOT_FOUND
    said = "camtopod daemon. Pages here:" if path == "/" else "There is no such page here. Try:"
    lines = [said, *(f"  {name}" for name in pages), "The map is served by `camtopod web`."]
    return Page(status, "text/plain; charset=utf-8", "\n".join([*lines, ""]).encode())


def _judgement(question: Reasons) -> Page:
    """Return the page that answers a question with its reasons."""
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
    """Serve at ``listen`` while the block runs; yield the address.

    listen: host:port; port 0 stands for a free one, "" for not serving at all.
    healthy: reasons against /healthz.
    ready: reasons against /readyz.
    others: further pages.

    Raises `ListenError`.
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

    # Listen.
    try:
        made = _Server(host.strip("[]"), int(port), pages)
    except (OSError, OverflowError) as error:
        raise ListenError(f"cannot listen at {listen} ([health] listen): {error}") from None

    # Serve in a thread.
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
