"""Login of the page: one password for people, one token for programs.

A browser that gives the password gets a session: a random name in a cookie, which the server keeps
until it ends. Programs send the token with each request. Both are read from files that only their
owner may read, as the cameras' passwords are. They are kept in memory as digests; as guesses are
limited, digests that take long to compute would protect nothing more.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import logging
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from importlib import resources
from urllib.parse import parse_qs

from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

log = logging.getLogger(__name__)

SESSION_SECONDS = 7 * 86_400.0
"""Lifetime of a session."""
SESSIONS_MAX = 1_000
"""Sessions that are kept; beyond it the oldest ends."""
TRIES_MAX = 5
"""Wrong passwords from one address within `TRIES_SECONDS`; further ones are not looked at."""
TRIES_SECONDS = 60.0
"""Time for which a wrong password counts."""
ADDRESSES_MAX = 1_000
"""Addresses of which wrong passwords are remembered; beyond it the oldest is forgotten."""
PASSWORD_CHARACTERS_MIN = 8
"""Shortest password."""
TOKEN_CHARACTERS_MIN = 20
"""Shortest token: nothing limits how often one may be guessed."""
FORM_BYTES_MAX = 4_096
"""Largest login form."""
COOKIE = "camtopod_session"
"""Name of the cookie, before the port: a browser sends cookies to all ports of a host."""
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
    """Password, token and sessions. Thread-safe. Raises `ValueError` for a secret that is short.

    token: None if programs have to use a session, too.
    steady: monotonic clock, in seconds.
    """

    def __init__(
        self, password: str, token: str | None = None, steady: Callable[[], float] = time.monotonic
    ) -> None:
        for name, secret, least in (
            ("password", password, PASSWORD_CHARACTERS_MIN),
            ("token", token, TOKEN_CHARACTERS_MIN),
        ):
            if secret is not None and len(secret) < least:
                raise ValueError(f"the {name} has fewer than {least} characters")
        self._password = _digest(password)
        self._token = None if token is None else _digest(token)
        self._steady = steady
        self._mutex = threading.Lock()
        self._sessions: OrderedDict[bytes, float] = OrderedDict()
        """By the digest of a session's name: when it ends."""
        self._wrong: OrderedDict[str, list[float]] = OrderedDict()
        """By address: times of wrong passwords."""

    def authorised(self, request: Request) -> bool:
        """Return True if a request has the token or belongs to a session."""
        kind, _, given = request.headers.get("authorization", "").partition(" ")
        if self._token is not None and kind.lower() == "bearer":
            return hmac.compare_digest(self._token, _digest(given.strip()))
        session = request.cookies.get(cookie_name(request))
        if session is None:
            return False
        with self._mutex:
            return self._sessions.get(_digest(session), -1.0) > self._steady()

    def open_session(self, password: str, address: str) -> str:
        """Return the name of a new session. Raises `LoginRefused`.

        address: from where the password was sent.
        """
        now = self._steady()
        with self._mutex:
            # Refuse addresses with too many wrong passwords.
            wrong = [t for t in self._wrong.pop(address, []) if now - t < TRIES_SECONDS]
            if len(wrong) >= TRIES_MAX:
                self._wrong[address] = wrong
                raise LoginRefused(TOO_MANY, 429)
            if not hmac.compare_digest(self._password, _digest(password)):
                self._wrong[address] = [*wrong, now]
                _limit(self._wrong, ADDRESSES_MAX)
                raise LoginRefused(WRONG, 403)

            # Open a session.
            session = secrets.token_urlsafe(32)
            self._sessions[_digest(session)] = now + SESSION_SECONDS
            _limit(self._sessions, SESSIONS_MAX)
            return session

    def end_session(self, session: str) -> None:
        """End a session, if there is one of this name."""
        with self._mutex:
            self._sessions.pop(_digest(session), None)

    async def page(self, request: Request) -> Response:
        """Show the login page, or take the password that it sends."""
        if request.method != "POST":
            return RedirectResponse("./", 303) if self.authorised(request) else _shown("", 200)

        # The form.
        content = b""
        async for part in request.stream():
            content += part
            if len(content) > FORM_BYTES_MAX:
                return _shown(WRONG, 413)
        given = parse_qs(content.decode("utf-8", "replace")).get("password", [""])[0]

        # The answer: a session, or an error message.
        address = _address_of(request)
        try:
            session = self.open_session(given, address)
        except LoginRefused as refused:
            log.warning("a login from %s was refused: %s", address, refused)
            return _shown(str(refused), refused.status)
        answer = RedirectResponse("./", 303)
        answer.set_cookie(
            cookie_name(request),
            session,
            max_age=int(SESSION_SECONDS),
            secure=request.url.scheme == "https",
            httponly=True,
            samesite="strict",
        )
        return answer

    def logout(self, request: Request) -> Response:
        """End the session of a request."""
        name = cookie_name(request)
        self.end_session(request.cookies.get(name, ""))
        answer = JSONResponse({})
        answer.delete_cookie(name)
        return answer


class LoginRefused(Exception):
    """A password was refused; ``status`` is that of the HTTP response."""

    def __init__(self, what: str, status: int) -> None:
        super().__init__(what)
        self.status = status


class LoginRequired:
    """Middleware for requests without a login: the page leads to the login, data is 401."""

    def __init__(self, app: ASGIApp, login: Login) -> None:
        self._app, self._login = app, login

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        app: ASGIApp = self._app
        if scope["type"] == "http" and scope["path"] not in OPEN_PATHS:
            request = Request(scope)
            if not self._login.authorised(request):
                app = (
                    RedirectResponse("login", 303)
                    if scope["path"] == "/"
                    else JSONResponse(
                        {"error": "this needs a login or a token"},
                        401,
                        {"www-authenticate": "Bearer"},
                    )
                )
        await app(scope, receive, send)


def cookie_name(request: Request) -> str:
    """Return the name of the session's cookie on this server."""
    return f"{COOKIE}_{request.url.port or request.url.scheme}"


def _address_of(request: Request) -> str:
    """Return the address of a client; of IPv6 the network, in which a client chooses freely."""
    host = request.client.host if request.client is not None else ""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if address.version == 6:
        return str(ipaddress.ip_network((address, 64), strict=False))
    return host


def _shown(message: str, status: int) -> Response:
    return HTMLResponse(
        _PAGE.replace("{message}", message), status, {"content-security-policy": PAGE_POLICY}
    )


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode()).digest()


def _limit(held: OrderedDict[str, list[float]] | OrderedDict[bytes, float], most: int) -> None:
    """Remove the oldest items beyond ``most``."""
    while len(held) > most:
        held.popitem(last=False)
