"""Serve ``GET /healthz`` (does every loop make progress?) and ``GET /readyz`` (is it ready?).

The answer is JSON with status 200 or 503. The caller can add further pages.
"""

from __future__ import annotations

import json
import logging
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import MappingProxyType
from typing import Any, NamedTuple

log = logging.getLogger(__name__)


CONNECTIONS_MAX = 64
"""Most open connections."""
REQUEST_SECONDS = 10.0
"""Time that a connection has for its request and the answer."""


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


class _Server(ThreadingHTTPServer):
    """A server with a thread for each connection, which has one request and one deadline.

    If there are too many, the newest one takes the place of the one that has waited longest for
    its request, else of the oldest.
    """

    block_on_close = False
    request_queue_size = CONNECTIONS_MAX

    def __init__(self, host: str, port: int, pages: Pages) -> None:
        self.pages = pages
        self._mutex = threading.Lock()
        self._since: dict[Any, float] = {}  # open connections, the oldest first
        self.busy_connections: set[Any] = set()
        """Connections whose request is there."""
        if ":" in host:
            self.address_family = socket.AF_INET6
        super().__init__((host, port), _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Make room for a new connection, and serve it."""
        with self._mutex:
            if len(self._since) >= CONNECTIONS_MAX:
                candidates = (
                    connection
                    for connection in self._since
                    if connection not in self.busy_connections
                )
                self._end(next(candidates, next(iter(self._since))))
            self._since[request] = time.monotonic()
        super().process_request(request, client_address)

    def service_actions(self) -> None:
        """End connections whose time is over; called several times a second."""
        before = time.monotonic() - REQUEST_SECONDS
        with self._mutex:
            for connection in [
                connection for connection, since in self._since.items() if since < before
            ]:
                self._end(connection)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection at the end of its thread."""
        with self._mutex:
            self._since.pop(request, None)
            self.busy_connections.discard(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log why a connection ended: a fault of a page is an error."""
        level = logging.DEBUG if isinstance(sys.exception(), OSError) else logging.ERROR
        log.log(level, "the connection from %s has ended", client_address, exc_info=True)

    def _end(self, connection: Any) -> None:
        """Wake a connection's thread, which finds it closed."""
        del self._since[connection]
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)


class _Handler(BaseHTTPRequestHandler):
    """One request on one connection."""

    server: _Server
    server_version = "camtopod"
    sys_version = ""

    def do_GET(self) -> None:
        """Answer with the page at the path, or with 404."""
        self.server.busy_connections.add(self.connection)
        make_page = self.server.pages.get(self.path.partition("?")[0])
        if make_page is None:
            self.send_error(HTTPStatus.NOT_FOUND, f"There are {', '.join(self.server.pages)}")
            return
        page = make_page()
        self.send_response(page.status)
        self.send_header("Content-Type", page.content_type)
        self.send_header("Content-Length", str(len(page.body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(page.body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log at level debug, as there may be a request every second."""
        log.debug(format, *args)


def _answer(question: Reasons) -> Page:
    """Return the page that answers a question with its reasons."""
    body: dict[str, object] = {"status": "ok", "reasons": []}
    status = HTTPStatus.OK
    if reasons := question()[:20]:
        body = {"status": "failing", "reasons": reasons}
        status = HTTPStatus.SERVICE_UNAVAILABLE
    return Page(status, "application/json", json.dumps(body).encode() + b"\n")


@contextmanager
def serving(
    listen: str, healthy: Reasons, ready: Reasons, extra_pages: Pages = MappingProxyType({})
) -> Iterator[str]:
    """Serve at ``listen`` while the block runs; yield the address.

    listen: host:port; port 0 stands for a free one, "" for not serving at all.
    healthy: reasons against /healthz.
    ready: reasons against /readyz.
    extra_pages: further pages.

    Raises `ListenError`.
    """
    if not listen:
        yield ""
        return

    host, _, port = listen.rpartition(":")
    pages = {"/healthz": lambda: _answer(healthy), "/readyz": lambda: _answer(ready), **extra_pages}
    try:
        server = _Server(host.strip("[]"), int(port), pages)
    except (OSError, OverflowError) as error:
        raise ListenError(f"cannot listen at {listen} ([health] listen): {error}") from None
    with server:
        threading.Thread(target=server.serve_forever, args=(0.1,), name="health").start()
        try:
            yield f"{host}:{server.server_address[1]}"
        finally:
            server.shutdown()
