"""Serve ``GET /healthz`` (does every loop make progress?) and ``GET /readyz`` (is it ready?).

The answer is JSON with status 200 or 503. The caller can add further pages.
"""

from __future__ import annotations

import json
import logging
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import MappingProxyType
from typing import Any, NamedTuple

log = logging.getLogger(__name__)


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
    """A server with a thread for each request."""

    block_on_close = False

    def __init__(self, host: str, port: int, pages: Pages) -> None:
        self.pages = pages
        if ":" in host:
            self.address_family = socket.AF_INET6
        super().__init__((host, port), _Handler)


class _Handler(BaseHTTPRequestHandler):
    """One request on one connection."""

    server: _Server
    server_version = "camtopod"
    sys_version = ""
    timeout = 2.0  # seconds without a byte, then the connection is closed

    def do_GET(self) -> None:
        """Answer with the page at the path, or with 404."""
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
    pages = {"/healthz": lambda: _answer(healthy), "/readyz": lambda: _answer(ready), **others}
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
