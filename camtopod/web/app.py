"""HTTP server of the page. Read-only; pages load nothing from other hosts."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import re
import socket
import threading
from collections.abc import AsyncIterator, Callable, Collection, Iterator
from importlib import resources
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
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

from camtopod.records import CAMERA_PATTERN, Topology
from camtopod.serve.bus import Bus
from camtopod.serve.runtime import Beat, Clock, Progress
from camtopod.web.api import Api
from camtopod.web.configured import Configured
from camtopod.web.connections import Connection, Seldom
from camtopod.web.feed import Feed
from camtopod.web.guards import Named, Strict
from camtopod.web.login import Login, LoginRequired
from camtopod.web.outbox import PageQueues
from camtopod.web.pictures import picture_of, pictured
from camtopod.web.version_cache import VersionCache
from camtopod.web.version_diff import changes

BEAT_SECONDS = 4.0
"""Longest interval between two messages to a page."""
CONNECTIONS_MAX = 1_024
"""Open connections; requests on further ones are answered with 503."""
CLOSE_SECONDS = 2
"""Time that open responses have to end when the server stops."""
_TICK_SECONDS = 0.2
_LOGGERS = ("camtopod.web.connections", "camtopod.web.login", "uvicorn.error")
"""Loggers of messages about clients."""
_NOTHING = Configured()
STATIC = resources.files("camtopod.web") / "static"


class _Version(IntegerConvertor):
    """Version number in a URL, limited to the digits that the daemon accepts.

    Python refuses to parse thousands of digits.
    """

    regex = "[0-9]{1,18}"


register_url_convertor("version", _Version())


class Routes:
    """Handlers of the routes."""

    def __init__(
        self,
        feed: Feed,
        past: VersionCache,
        hub: PageQueues,
        pictures: Path | None,
        configured: Configured,
        has_login: bool,
    ) -> None:
        self._feed, self._past, self._hub, self._pictures = feed, past, hub, pictures
        self._configured, self._has_login = configured, has_login

    def map(self, request: Request) -> Response:
        """Return the newest version's map; null if nothing has been learned."""
        return Response(self._feed.map_json, media_type="application/json")

    def health(self, request: Request) -> Response:
        """Return state and reason of the daemon and of every camera."""
        return _json({**self._feed.health(), "login": self._has_login})

    def camera(self, request: Request) -> Response:
        """Return one camera's zones and links, and whether there is a picture."""
        name = request.path_params["camera"]
        story = self._feed.stories.camera(name) if self._feed.stories else None
        if story is None:
            return _json({"error": f"camera {name} is not in the newest version"}, 404)
        return _json(
            {
                **story,
                "picture": self._picture_of(name) is not None,
                "page": self._configured.pages.get(name),
                "hours": self._feed.hours_of(name),
            }
        )

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

    def placement(self, request: Request) -> Response:
        """Return the cameras' places on the floor plan; null without a plan."""
        plan = self._configured.plan
        return _json(None if plan is None else {"at": self._configured.at})

    def plan(self, request: Request) -> Response:
        """Return the floor plan."""
        plan = self._configured.plan
        if plan is None or not os.access(plan, os.R_OK):
            return _json({"error": "no floor plan"}, 404)
        return FileResponse(plan)

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


def application(
    site: Routes,
    api: Api,
    names: Collection[str],
    any_address: bool,
    login: Login | None,
    beat: Beat,
) -> Starlette:
    """Return the web application, which accepts only ``names``, and addresses if ``any_address``.

    login: asked for every request; None for a page without a password.
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
        Route("/data/placement", site.placement),
        Route("/plan", site.plan),
        Route("/picture/{camera}", site.picture),
        Route("/live", site.live),
        *api.routes(),
        *([] if login is None else _login_routes(login)),
        Route("/api/openapi.json", lambda request: FileResponse(str(STATIC / "openapi.json"))),
    ]

    middleware = [
        Middleware(Strict),
        Middleware(Named, names=names, any_address=any_address),
        *([] if login is None else [Middleware(LoginRequired, login=login)]),
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
    login: Login | None = None,
    configured: Configured = _NOTHING,
) -> Iterator[Callable[[], bool]]:
    """Serve the page from a listening socket, in threads, while the block runs.

    Yields a function that returns True if all threads are alive.

    names, any_address: accepted host names, and whether every IP address is accepted.
    progress: receives the progress of the threads.
    stall_seconds: time after which a thread without progress counts as stalled.
    login: None for a page without a password.
    configured: the configuration's settings of the page.
    """
    # Progress marks, bus followers, HTTP server.
    marks = progress or Progress()
    page, versions, messages = (
        marks.watch(name, stall_seconds) for name in ("page", "versions", "messages")
    )
    stop = threading.Event()
    hub = PageQueues()
    feed, past = Feed(bus, hub, clock, status_seconds), VersionCache(bus)
    api = Api(bus, feed, past, is_open=login is not None or not any_address)
    site = Routes(feed, past, hub, pictures, configured, login is not None)
    config = uvicorn.Config(
        application(site, api, names, any_address, login, page.beat),
        log_config=None,
        log_level="warning",
        access_log=False,
        lifespan="on",
        server_header=False,
        limit_concurrency=CONNECTIONS_MAX,
        timeout_graceful_shutdown=CLOSE_SECONDS,
        http=Connection,
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
    seldom, loggers = Seldom(), [logging.getLogger(name) for name in _LOGGERS]
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


def _login_routes(login: Login) -> list[Route]:
    return [
        Route("/login", login.page, methods=["GET", "POST"]),
        Route("/logout", login.logout, methods=["POST"]),
    ]


def _json(content: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type="application/json")


def _not_kept(version: int) -> Response:
    return _json({"error": f"version {version} is not kept, or the daemon cannot be reached"}, 404)
