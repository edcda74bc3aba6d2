"""HTTP server of the page. Read-only; pages load nothing from other hosts."""

from __future__ import annotations

import asyncio
import contextlib
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
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

from camtopod.records import CAMERA_PATTERN
from camtopod.serve.bus import Bus
from camtopod.serve.runtime import STALL_SECONDS, Beat, Clock, Progress
from camtopod.web.api import Api
from camtopod.web.configured import Configured
from camtopod.web.explanations import Explanations
from camtopod.web.feed import Feed
from camtopod.web.guards import Guard
from camtopod.web.login import Login
from camtopod.web.outbox import PageQueues
from camtopod.web.pictures import picture_of, pictured

CONNECTIONS_MAX = 1_024
"""Open connections; requests on further ones are answered with 503."""
CLOSE_SECONDS = 2
"""Time that open responses have to end when the server stops."""
_NOTHING = Configured()
STATIC = resources.files("camtopod.web").joinpath("static")


class Routes:
    """Handlers of the routes."""

    def __init__(
        self,
        feed: Feed,
        page_queues: PageQueues,
        pictures: Path | None,
        configured: Configured,
        has_login: bool,
    ) -> None:
        self._feed = feed
        self._page_queues = page_queues
        self._pictures = pictures
        self._configured = configured
        self._has_login = has_login

    def map(self, request: Request) -> Response:
        """Return the newest version's map; null if nothing has been learned."""
        return Response(self._feed.map_json, media_type="application/json")

    def health(self, request: Request) -> Response:
        """Return state and reason of the daemon and of every camera."""
        return _json({**self._feed.health(), "login": self._has_login})

    def camera(self, request: Request) -> Response:
        """Return one camera's zones and links, and whether there is a picture."""
        name = request.path_params["camera"]
        explanations = self._feed.explanations
        details = explanations and explanations.camera(name)
        if not details:
            return _json({"error": f"camera {name} is not in the newest version"}, 404)
        more = {
            "picture": self._picture_of(name) is not None,
            "page": self._configured.pages.get(name),
            "hours": self._feed.hours_of(name),
        }
        return _json({**details, **more})

    def pair(self, request: Request) -> Response:
        """Return the links between two cameras."""
        a = request.path_params["a"]
        b = request.path_params["b"]
        return self._explained(lambda version: version.pair(a, b), f"between {a} and {b}")

    def link(self, request: Request) -> Response:
        """Return one link, given by ``from``, ``to`` and ``relation``."""
        key = [request.query_params.get(name, "") for name in ("from", "to", "relation")]
        return self._explained(lambda version: version.link(*key), f"{key[0]} → {key[1]}")

    def versions(self, request: Request) -> Response:
        """Return summaries of the versions since this server began, oldest first."""
        return _json(self._feed.versions)

    def pictures(self, request: Request) -> Response:
        """Return the cameras of which there is a picture."""
        try:
            return _json(pictured(self._pictures))
        except OSError:  # the command has warned of it
            return _json([])

    def placement(self, request: Request) -> Response:
        """Return the cameras' places on the floor plan; null without a plan."""
        if self._configured.plan is None:
            return _json(None)
        return _json({"at": self._configured.at})

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

    def _explained(
        self, details_of: Callable[[Explanations], dict[str, Any] | None], ends: str
    ) -> Response:
        """Return details of the newest version, or that it has no link with these ends."""
        explanations = self._feed.explanations
        if explanations is not None and (details := details_of(explanations)) is not None:
            return _json(details)
        return _json({"error": f"the newest version has no link {ends}"}, 404)

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
        page_queue = self._page_queues.open(camera)
        if page_queue is None:
            return _json({"error": "too many pages are open"}, 503)

        async def stream() -> AsyncIterator[bytes]:
            async with contextlib.AsyncExitStack() as stack:
                stack.callback(self._page_queues.leave, page_queue)
                if camera is not None:
                    watching = self._feed.watching(camera)
                    await run_in_threadpool(watching.__enter__)
                    stack.callback(watching.__exit__, None, None, None)
                yield b"retry: 1000\n\n" + self._feed.beat() + self._feed.hello()
                while (message := await page_queue.take()) is not None:
                    yield message or self._feed.beat()

        return StreamingResponse(stream(), media_type="text/event-stream")


def application(
    site: Routes,
    api: Api,
    names: Collection[str],
    login: Login | None,
    beat: Beat,
) -> Starlette:
    """Return the web application.

    names: accepted host names, besides IP addresses.
    login: asked for every request; None for a page without a password.
    beat: called regularly as long as the application's event loop makes progress.
    """

    @contextlib.asynccontextmanager
    async def living(app: Starlette) -> AsyncIterator[None]:
        async def beats() -> None:
            while True:
                beat()
                await asyncio.sleep(0.2)

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
        Route("/data/pictures", site.pictures),
        Route("/data/placement", site.placement),
        Route("/plan", site.plan),
        Route("/picture/{camera}", site.picture),
        Route("/live", site.live),
        *api.routes(),
    ]
    if login is not None:
        routes.append(Route("/login", login.page, methods=["GET", "POST"]))
        routes.append(Route("/logout", login.logout, methods=["POST"]))

    middleware = [
        Middleware(Guard, names=names, login=login),
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
    is_public: bool = False,
    progress: Progress | None = None,
    login: Login | None = None,
    configured: Configured = _NOTHING,
) -> Iterator[Callable[[], bool]]:
    """Serve the page from a listening socket, in threads, while the block runs.

    Yields a function that returns True if all threads are alive.

    names: accepted host names, besides IP addresses.
    is_public: whether other machines can connect; then the API needs a login.
    progress: receives the progress of the threads.
    login: None for a page without a password.
    configured: the configuration's settings of the page.
    """
    # Progress marks, bus followers, HTTP server.
    marks = progress or Progress()
    page, versions, messages = (
        marks.watch(name, STALL_SECONDS) for name in ("page", "versions", "messages")
    )
    stop = threading.Event()
    page_queues = PageQueues()
    feed = Feed(bus, page_queues, clock, status_seconds)
    api = Api(bus, feed, is_open=login is not None or not is_public)
    site = Routes(feed, page_queues, pictures, configured, login is not None)
    config = uvicorn.Config(
        application(site, api, names, login, page.beat),
        log_config=None,
        log_level="error",  # not each invalid request
        access_log=False,
        lifespan="on",
        server_header=False,
        limit_concurrency=CONNECTIONS_MAX,
        timeout_graceful_shutdown=CLOSE_SECONDS,
        http="h11",
    )
    server = uvicorn.Server(config)

    # One thread for each.
    threads = [
        threading.Thread(target=server.run, args=[[listener]], name="page", daemon=True),
        threading.Thread(
            target=feed.follow_versions, args=[stop, versions.beat], name="versions", daemon=True
        ),
        threading.Thread(
            target=feed.follow_messages, args=[stop, messages.beat], name="messages", daemon=True
        ),
    ]

    for thread in threads:
        thread.start()
    try:
        yield lambda: all(thread.is_alive() for thread in threads)
    finally:
        stop.set()
        page_queues.close()
        api.close()
        server.should_exit = True
        for thread in threads:
            thread.join(CLOSE_SECONDS + 1)


def _json(content: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(content), status, media_type="application/json")
