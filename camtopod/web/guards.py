"""Middleware of every request: response headers and accepted host names."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Collection

from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

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
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+)(?::[0-9]{1,5})?")
"""Host header: address or name, and optionally a port."""


class Strict:
    """Middleware that adds `HEADERS` to every response, as far as it does not have its own."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def strict(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = {name for name, _ in message["headers"]}
                added = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                missing = [header for header in added if header[0] not in given]
                message = {**message, "headers": [*message["headers"], *missing]}
            await send(message)

        await self._app(scope, receive, strict)


class Named:
    """Middleware that refuses requests for host names other than ``names``.

    With ``any_address`` every IP address is accepted, too. Otherwise any web page could read this
    one by making its own name resolve to this server (DNS rebinding).
    """

    def __init__(self, app: ASGIApp, names: Collection[str], any_address: bool) -> None:
        self._app = app
        self._names, self._any_address = {name.lower() for name in names}, any_address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        app = (
            self._app
            if scope["type"] != "http" or self._is_ours(Request(scope))
            else PlainTextResponse(REFUSED, 421)
        )
        await app(scope, receive, send)

    def _is_ours(self, request: Request) -> bool:
        match = _HOST.fullmatch(request.headers.get("host", ""))
        if match is None:
            return False
        asked = match[1].lower()
        return asked in self._names or (self._any_address and _is_address(asked.strip("[]")))


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True
