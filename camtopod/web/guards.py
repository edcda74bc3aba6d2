"""Middleware of every request: accepted host names, login, response headers."""

from __future__ import annotations

import contextlib
import ipaddress
from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from camtopod.web.login import Login

HEADERS = {
    "cache-control": "no-cache",
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}
"""Headers of every response: same origin only, no inline scripts, no caching without validation."""
REFUSED = (
    "This page does not accept that host name. Open it by its IP address, or allow the name: "
    "camtopod web --name NAME\n"
)
"""Body of the response to a request for an unknown host name."""


class Guard:
    """Middleware that answers logged-in users, and only under known host names.

    Any IP address is a known name. Otherwise any web page could read this one by making its own
    name resolve to this server (DNS rebinding). Every response gets `HEADERS`, as far as it does
    not have its own.

    names: accepted host names.
    login: None for a page without a password.
    """

    def __init__(self, app: ASGIApp, names: Collection[str], login: Login | None) -> None:
        self._app = app
        self._names = {name.lower() for name in names}
        self._login = login

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                header_names = {name for name, _ in message["headers"]}
                defaults = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                additions = [header for header in defaults if header[0] not in header_names]
                message = {**message, "headers": [*message["headers"], *additions]}
            await send(message)

        app = self._app
        if scope["type"] == "http":
            request = Request(scope)
            if not self._knows(request.headers.get("host", "")):
                app = PlainTextResponse(REFUSED, 421)
            elif self._login is not None and not self._login.lets_in(request):
                app = self._login.refusal(request)
        await app(scope, receive, send_with_headers)

    def _knows(self, host: str) -> bool:
        """Return True for the Host header of an accepted name or any address."""
        with contextlib.suppress(ValueError):
            name = urlsplit(f"//{host}").hostname or ""
            if name in self._names:
                return True
            ipaddress.ip_address(name)
            return True
        return False
