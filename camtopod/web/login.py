"""Login of the page: one password for people, one token for programs.

A browser that gives the password gets a cookie that says until when it is logged in, signed with a
key that ends with this process. Programs send the token with each request.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import logging
import secrets
from collections import Counter
from importlib import resources
from urllib.parse import parse_qs

from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response

from camtopod.config import secret_files
from camtopod.serve.runtime import Clock, clock

log = logging.getLogger(__name__)

SESSION_SECONDS = 7 * 86_400
"""Time for which a login is valid."""
TRIES_PER_MINUTE_MAX = 5
"""Wrong passwords of one guesser within a minute; further ones are not compared."""
PASSWORD_CHARACTERS_MIN = 8
"""Shortest password."""
TOKEN_CHARACTERS_MIN = 20
"""Shortest token: nothing limits how often one may be guessed."""
WRONG = "That is not the password."
TOO_MANY = "Too many wrong passwords: wait a minute."
OPEN_PATHS = ("/login", "/static/app.css", "/static/icon.svg")
"""Paths that need no login."""
PAGE_POLICY = (
    "default-src 'none'; style-src 'self'; img-src 'self'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
"""Content security policy of the login page, which sends a form."""
_PAGE = (resources.files("camtopod.web") / "static" / "login.html").read_text("utf-8")


class Login:
    """Password and token. Raises `ValueError` for a secret that is short.

    token: None if programs have to log in with the password, too.
    clock: Unix seconds.
    """

    def __init__(self, password: str, token: str | None = None, clock: Clock = clock.wall) -> None:
        if len(password) < PASSWORD_CHARACTERS_MIN:
            raise ValueError(f"the password has fewer than {PASSWORD_CHARACTERS_MIN} characters")
        if token is not None and len(token) < TOKEN_CHARACTERS_MIN:
            raise ValueError(f"the token has fewer than {TOKEN_CHARACTERS_MIN} characters")
        self._password = password
        self._token = token
        self._clock = clock
        self._key = secrets.token_bytes(32)
        self._minute = 0.0
        self._wrong: Counter[str] = Counter()
        """By guesser: wrong passwords in this minute."""

    def lets_in(self, request: Request) -> bool:
        """Return True if a request has the token or the cookie, or asks for the login page."""
        if request.scope["path"] in OPEN_PATHS:
            return True
        kind, _, token = request.headers.get("authorization", "").partition(" ")
        if self._token is not None and kind.lower() == "bearer":
            return _same(token.strip(), self._token)
        ends, _, signature = request.cookies.get(cookie_name(request), "").partition(".")
        return _same(signature, self._signature(ends)) and int(ends) > self._clock()

    def refusal(self, request: Request) -> Response:
        """Return the response to a request without a login: the page leads to it, data is 401."""
        if request.scope["path"] == "/":
            return RedirectResponse("login", 303)
        error = {"error": "this needs a login or a token"}
        return JSONResponse(error, 401, {"www-authenticate": "Bearer"})

    async def page(self, request: Request) -> Response:
        """Show the login page, or take the password that it sends."""
        if request.method != "POST":
            return _login_page("", 200)
        if int(request.headers.get("content-length", 1 << 31)) > secret_files.BYTES_MAX:
            return _login_page(WRONG, 413)
        try:
            content = (await request.body()).decode("utf-8", "replace")
        except ClientDisconnect:  # or it took too long
            return Response()
        password = parse_qs(content).get("password", [""])[0]

        # Count wrong passwords by the minute.
        if self._clock() // 60 != self._minute:
            self._minute = self._clock() // 60
            self._wrong.clear()
        address = guesser(request)
        if self._wrong[address] >= TRIES_PER_MINUTE_MAX:
            return _login_page(TOO_MANY, 429)
        if not _same(password, self._password):
            self._wrong[address] += 1
            log.warning("a login from %s was refused: %s", address, WRONG)
            return _login_page(WRONG, 403)

        # The password is right.
        ends = str(int(self._clock()) + SESSION_SECONDS)
        answer = RedirectResponse("./", 303)
        answer.set_cookie(
            cookie_name(request),
            f"{ends}.{self._signature(ends)}",
            max_age=SESSION_SECONDS,
            secure=request.headers.get("x-forwarded-proto") == "https",
            httponly=True,
            samesite="strict",
        )
        return answer

    def logout(self, request: Request) -> Response:
        """Take the cookie away."""
        answer = JSONResponse({})
        answer.delete_cookie(cookie_name(request))
        return answer

    def _signature(self, text: str) -> str:
        return hmac.new(self._key, text.encode(), hashlib.sha256).hexdigest()


def guesser(request: Request) -> str:
    """Return whose wrong passwords count together: those of all addresses that one may choose from.

    What a header says of addresses is not believed. To itself a machine has many, and in IPv6 a
    client has a whole network.
    """
    host = request.client.host if request.client else "::1"
    address = ipaddress.ip_address(host.partition("%")[0])
    if address.is_loopback:
        return "this machine"
    return str(address) if address.version == 4 else str(ipaddress.ip_network((address, 64), False))


def cookie_name(request: Request) -> str:
    """Return the cookie's name: a browser sends those of all ports of a host."""
    return f"camtopod_session_{request.url.port or request.url.scheme}"


def _same(text: str, expected: str) -> bool:
    """Compare in a time that does not depend on the content."""
    return hmac.compare_digest(text.encode(), expected.encode())


def _login_page(message: str, status: int) -> Response:
    policy = {"content-security-policy": PAGE_POLICY}
    return HTMLResponse(_PAGE.replace("{message}", message), status, policy)
