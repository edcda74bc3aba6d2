"""HTTP server of the page. Read-only; pages load nothing from other hosts.

The only module that uses uvicorn, and with `api` the only one that uses starlette.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import logging
import math
import os
import re
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Collection, Iterator
from importlib import resources
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.convertors import IntegerConvertor, register_url_convertor
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from camtopod.records import CAMERA_PATTERN, Topology
from camtopod.serve.bus import Bus
from camtopod.serve.runtime import Beat, Clock, Progress
from camtopod.web.api import Api
from camtopod.web.feed import Feed
from camtopod.web.outbox import PageQueues
from camtopod.web.pictures import picture_of, pictured
from camtopod.web.version_cache import VersionCache
from camtopod.web.version_diff import changes

log = logging.getLogger(__name__)

BEAT_SECONDS = 4.0
"""Longest interval between two messages to a page."""
CONNECTIONS_MAX = 1_024
"""Open connections; requests on further ones are answered with 503."""
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
CLOSE_SECONDS = 2
"""Time that open responses have to end when the server stops."""
_TICK_SECONDS = 0.2
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
STATIC = resources.files("camtopod.web") / "static"


class _Version(IntegerConvertor):
    """Version number in a URL, limited to the digits that the daemon accepts.

    Python refuses to parse thousands of digits.
    """

    regex = "[0-9]{1,18}"


register_url_convertor("version", _Version())


class _Strict:
    """Middleware that adds `HEADERS` to every response."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def strict(message: Message) -> None:
            if message["type"] == "http.response.start":
                added = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                message = {**message, "headers": [*message["headers"], *added]}
            await send(message)

        await self._app(scope, receive, strict)


class _Named:
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


class Routes:
    """Handlers of the routes."""

    def __init__(
        self, feed: Feed, past: VersionCache, hub: PageQueues, pictures: Path | None
    ) -> None:
        self._feed, self._past, self._hub, self._pictures = feed, past, hub, pictures

    def map(self, request: Request) -> Response:
        """Return the newest version's map; null if nothing has been learned."""
        return Response(self._feed.map_json, media_type="application/json")

    def health(self, request: Request) -> Response:
        """Return state and reason of the daemon and of every camera."""
        return _json(self._feed.health())

    def camera(self, request: Request) -> Response:
        """Return one camera's zones and links, and whether there is a picture."""
        name = request.path_params["camera"]
        story = self._feed.stories.camera(name) if self._feed.stories else None
        if story is None:
            return _json({"error": f"camera {name} is not in the newest version"}, 404)
        return _json({**story, "picture": self._picture_of(name) is not None})

    def pair(self, request: Request) -> Response:
        """Return the links between two cameras."""
        a, b = request.path_params["a"], request.path_params["b"]
        story = self._feed.stories.pair(a, b) if self._feed.stories else None
        return (
            _json(story)
            if story
            else _json({"error": f"the newest version has no link between {a} and {b}"}, 404)
        )

    def link(self, request: Request) -> Response:
        """Return one link, given by ``from``, ``to`` and ``relation``."""
        key = [request.query_params.get(name, "") for name in ("from", "to", "relation")]
        story = self._feed.stories.link(*key) if self._feed.stories else None
        return (
            _json(story)
            if story
            else _json({"error": f"the newest version has no link {key[0]} → {key[1]}"}, 404)
        )

    def versions(self, request: Request) -> Response:
        """Return summaries of the versions known without a query to the daemon."""
        newest = self._newest
        return _json([] if newest is None else self._past.summaries(newest))

    def version(self, request: Request) -> Response:
        """Return a version's summary, querying the daemon if necessary."""
        newest, number = self._newest, request.path_params["version"]
        found = None if newest is None else self._past.summary(newest, number)
        return _json(found) if found else _not_kept(number)

    def changes(self, request: Request) -> Response:
        """Return the changes from version ``old`` to ``new``."""
        newest = self._newest
        numbers = request.path_params["old"], request.path_params["new"]
        found: list[Topology] = []
        for number in numbers:
            one = None if newest is None else self._past.version(newest, number)
            if one is None:
                return _not_kept(number)
            found.append(one)
        return _json(changes(*found))

    @property
    def _newest(self) -> Topology | None:
        return None if self._feed.stories is None else self._feed.stories.topology

    def pictures(self, request: Request) -> Response:
        """Return the cameras of which there is a picture."""
        try:
            return _json(pictured(self._pictures))
        except OSError:  # the command has warned of it
            return _json([])

    def picture(self, request: Request) -> Response:
        """Return a camera's picture, if there is one in the folder."""
        path = self._picture_of(request.path_params["camera"])
        if path is None:
            return _json({"error": "no picture"}, 404)
        return FileResponse(path)

    def _picture_of(self, camera: str) -> Path | None:
        """Return the path of a camera's picture; None if there is none that this user may read.

        The camera's page works without a picture.
        """
        try:
            path = picture_of(self._pictures, camera)
        except PermissionError:  # raised for the folder
            return None
        return path if path is not None and os.access(path, os.R_OK) else None

    async def live(self, request: Request) -> Response:
        """Stream server-sent events: all news and, with ``camera``, that camera's events."""
        camera = request.query_params.get("camera")
        if camera is not None and not re.match(CAMERA_PATTERN, camera):
            return _json({"error": "not a valid camera id"}, 404)
        box = self._hub.open(camera)
        if box is None:
            return _json({"error": "too many pages are open"}, 503)

        async def stream() -> AsyncIterator[bytes]:
            async with contextlib.AsyncExitStack() as stack:
                stack.callback(self._hub.leave, box)
                if camera is not None:
                    watching = self._feed.watching(camera)
                    await run_in_threadpool(watching.__enter__)
                    stack.callback(watching.__exit__, None, None, None)
                yield b"retry: 1000\n\n" + self._feed.beat() + self._feed.hello()
                while (messages := await box.take(BEAT_SECONDS)) is not None:
                    yield messages or self._feed.beat()

        return StreamingResponse(stream(), media_type="text/event-stream")


class _Seldom(logging.Filter):
    """Log filter that passes each message once in `LOG_INTERVAL_SECONDS`, with the number
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


class _Connection(H11Protocol):
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
            if isinstance(one, _Connection) and one.waiting_since is not None
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


def application(
    site: Routes, api: Api, names: Collection[str], any_address: bool, beat: Beat
) -> Starlette:
    """Return the web application, which accepts only ``names``, and addresses if ``any_address``.

    beat: called regularly as long as the application's event loop makes progress.
    """

    @contextlib.asynccontextmanager
    async def living(app: Starlette) -> AsyncIterator[None]:
        async def beats() -> None:
            while True:
                beat()
                await asyncio.sleep(_TICK_SECONDS)

        task = asyncio.create_task(beats())
        try:
            yield
        finally:
            task.cancel()

    routes = [
        Route("/", lambda request: FileResponse(str(STATIC / "index.html"))),
        Route("/data/map", site.map),
        Route("/data/health", site.health),
        Route("/data/camera/{camera}", site.camera),
        Route("/data/pair/{a}/{b}", site.pair),
        Route("/data/link", site.link),
        Route("/data/versions", site.versions),
        Route("/data/version/{version:version}", site.version),
        Route("/data/changes/{old:version}/{new:version}", site.changes),
        Route("/data/pictures", site.pictures),
        Route("/picture/{camera}", site.picture),
        Route("/live", site.live),
        *api.routes(),
        Route("/api/openapi.json", lambda request: FileResponse(str(STATIC / "openapi.json"))),
    ]

    middleware = [
        Middleware(_Strict),
        Middleware(_Named, names=names, any_address=any_address),
        Middleware(GZipMiddleware, minimum_size=1000, compresslevel=5),
    ]
    app = Starlette(routes=routes, middleware=middleware, lifespan=living)
    app.mount("/static", StaticFiles(directory=str(STATIC)))
    return app


@contextlib.contextmanager
def serving(
    bus: Bus,
    listener: socket.socket,
    names: Collection[str],
    pictures: Path | None,
    clock: Clock,
    status_seconds: float,
    any_address: bool = False,
    progress: Progress | None = None,
    stall_seconds: float = math.inf,
) -> Iterator[Callable[[], bool]]:
    """Serve the page from a listening socket, in threads, while the block runs.

    Yields a function that returns True if all threads are alive.

    names, any_address: accepted host names, and whether every IP address is accepted.
    progress: receives the progress of the threads.
    stall_seconds: time after which a thread without progress counts as stalled.
    """
    # Progress marks, bus followers, HTTP server.
    marks = progress or Progress()
    page, versions, messages = (
        marks.watch(name, stall_seconds) for name in ("page", "versions", "messages")
    )
    stop = threading.Event()
    hub = PageQueues()
    feed, past = Feed(bus, hub, clock, status_seconds), VersionCache(bus)
    api = Api(bus, feed, past, is_open=not any_address)
    config = uvicorn.Config(
        application(Routes(feed, past, hub, pictures), api, names, any_address, page.beat),
        log_config=None,
        log_level="warning",
        access_log=False,
        lifespan="on",
        server_header=False,
        limit_concurrency=CONNECTIONS_MAX,
        timeout_graceful_shutdown=CLOSE_SECONDS,
        http=_Connection,
    )
    server = uvicorn.Server(config)

    # One thread for each.
    threads = [
        threading.Thread(target=server.run, args=[[listener]], name="page", daemon=True),
        threading.Thread(
            target=feed.versions, args=[stop, versions.beat], name="versions", daemon=True
        ),
        threading.Thread(
            target=feed.messages, args=[stop, messages.beat], name="messages", daemon=True
        ),
    ]

    # Limit repeated log messages.
    seldom, loggers = _Seldom(), (log, logging.getLogger("uvicorn.error"))
    for logger in loggers:
        logger.addFilter(seldom)
    for thread in threads:
        thread.start()
    try:
        yield lambda: all(thread.is_alive() for thread in threads)
    finally:
        stop.set()
        hub.close()
        api.close()
        server.should_exit = True
        for thread in threads:
            thread.join(CLOSE_SECONDS + 1)
        for logger in loggers:
            logger.removeFilter(seldom)


def _json(content: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type="application/json")


def _not_kept(version: int) -> Response:
    return _json({"error": f"version {version} is not kept, or the daemon cannot be reached"}, 404)
