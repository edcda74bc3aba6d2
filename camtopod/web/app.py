"""HTTP server of the page. Read-only; pages load nothing from other hosts."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import socket
import threading
from collections.abc import AsyncIterator, Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

from camtopod.config import CameraSettings, Config
from camtopod.serve.bus import Bus
from camtopod.serve.city_bus import CityBus
from camtopod.serve.runtime import STALL_SECONDS, Beat, Clock, Progress
from camtopod.web.api import Api, Asking, content, error, streamed
from camtopod.web.connections import HttpConnection
from camtopod.web.explanations import empty_camera
from camtopod.web.feed import MATCHES_SHOWN, Feed, shown_match
from camtopod.web.growth import steps
from camtopod.web.guards import Guard
from camtopod.web.login import Login
from camtopod.web.outbox import PageQueues
from camtopod.web.pictures import picture_of
from camtopod.web.report import gather, placed
from camtopod.web.single_file import STATIC, page

GATHERING_MAX = 2
"""Requests at a time for pages that are gathered from many versions."""
CLOSE_SECONDS = 2
"""Time that open responses have to end when the server stops."""


class Routes:
    """Handlers of the page's routes."""

    def __init__(
        self,
        feed: Feed,
        page_queues: PageQueues,
        config: Config,
        has_login: bool,
        bus: Bus | CityBus,
    ) -> None:
        self._feed = feed
        self._page_queues = page_queues
        self._pictures = config.web.pictures_folder
        self._config = config
        self._has_login = has_login
        self._bus = bus

    def map(self, request: Request) -> Response:
        """Return the newest version's map; null if nothing has been learned."""
        return Response(self._feed.map_json, media_type="application/json")

    def health(self, request: Request) -> Response:
        """Return state and reason of the daemon and of every camera."""
        return content({**self._feed.health(), "login": self._has_login})

    def camera(self, request: Request) -> Response:
        """Return one camera's zones and links, and whether there is a picture."""
        name = request.path_params["camera"]
        explanations = self._feed.explanations
        details = explanations.camera(name) if explanations else None
        if details is None and name in self._feed.map.cameras:
            details = empty_camera(name)
        return details_or_404(
            f"camera {name}",
            details,
            picture=picture_of(self._pictures, name) is not None,
            page=self._config.cameras.get(name, CameraSettings()).page or None,
        )

    def pair(self, request: Request) -> Response:
        """Return the links between two cameras."""
        a = request.path_params["a"]
        b = request.path_params["b"]
        explanations = self._feed.explanations
        details = explanations.pair(a, b) if explanations else None
        return details_or_404(f"a link between {a} and {b}", details)

    def link(self, request: Request) -> Response:
        """Return one link, given by ``from``, ``to`` and ``relation``."""
        from_, to, relation = (request.query_params.get(k, "") for k in ("from", "to", "relation"))
        explanations = self._feed.explanations
        details = explanations.link(from_, to, relation) if explanations else None
        return details_or_404(f"the link {from_} → {to}", details)

    def walks(self, request: Request) -> Response:
        """Return the newest matches or, with ``all``, those of the last hour, oldest first."""
        matches = self._feed.walks(-math.inf)
        if "all" not in request.query_params:
            matches = matches[-MATCHES_SHOWN:]
        return content([shown_match(match) for match in matches])

    def pictures(self, request: Request) -> Response:
        """Return the cameras of which there is a picture."""
        return content(
            [name for name in self._feed.map.cameras if picture_of(self._pictures, name)]
        )

    def growth(self, request: Request) -> Response:
        """Return what the maps of earlier versions had, oldest first."""
        newest = self._feed.topology
        return content([] if newest is None else steps(self._bus, newest))

    def report(self, request: Request) -> Response:
        """Return the page as one file, with the events of the last hour and without walks."""
        newest = self._feed.topology
        if newest is None:
            return error(404, "nothing has been learned yet")
        data = {
            **gather(newest, [], self._pictures, self._config),
            "versions": self._feed.versions,
            "growth": steps(self._bus, newest),
            "recent": self._feed.recent(),
        }
        return HTMLResponse(page(data), headers={"Content-Disposition": "attachment"})

    def placement(self, request: Request) -> Response:
        """Return the cameras' places on the floor plan; null without a plan."""
        return content({"at": placed(self._config)} if self._config.map.plan else None)

    def plan(self, request: Request) -> Response:
        """Return the floor plan."""
        return _file(self._config.map.plan)

    def picture(self, request: Request) -> Response:
        """Return a camera's picture, if there is one in the folder."""
        return _file(picture_of(self._pictures, request.path_params["camera"]) or "")

    async def live(self, request: Request) -> Response:
        """Stream server-sent events: all news."""
        page_queue = self._page_queues.open()
        if page_queue is None:
            return error(503, "too many pages are open")

        async def stream() -> AsyncIterator[bytes]:
            yield b"retry: 1000\n\n" + self._feed.beat() + self._feed.hello()
            async for message in self._page_queues.messages(page_queue, self._feed.beat):
                yield message

        return streamed(stream())


def details_or_404(subject: str, details: dict[str, Any] | None, **extras: Any) -> Response:
    """Return the response with details of the newest version, or that it does not have them."""
    if not details:
        return error(404, f"{subject} is not in the newest version")
    return content({**details, **extras})


def application(
    site: Routes, api: Api, names: Collection[str], login: Login | None, beat: Beat
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

    gathering = Asking(GATHERING_MAX)
    routes = [
        Route("/", lambda request: FileResponse(str(STATIC / "index.html"))),
        Route("/data/map", site.map),
        Route("/data/health", site.health),
        Route("/data/camera/{camera}", site.camera),
        Route("/data/pair/{a}/{b}", site.pair),
        Route("/data/link", site.link),
        Route("/data/versions", api.versions),
        Route("/data/walks", site.walks),
        Route("/data/recent", api.asking(api.recent)),
        Route("/data/hours", api.asking(api.hours)),
        Route("/data/growth", gathering(site.growth)),
        Route("/data/pictures", site.pictures),
        Route("/data/placement", site.placement),
        Route("/plan", site.plan),
        Route("/report.html", gathering(site.report)),
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
    handlers: Any = {HTTPException: lambda _, e: error(e.status_code, e.detail, e.headers)}
    app = Starlette(
        routes=routes, middleware=middleware, exception_handlers=handlers, lifespan=living
    )
    app.mount("/static", StaticFiles(directory=str(STATIC)))
    return app


@contextlib.contextmanager
def serving(
    bus: Bus | CityBus,
    listener: socket.socket,
    names: Collection[str],
    clock: Clock,
    config: Config,
    is_public: bool = False,
    progress: Progress | None = None,
    login: Login | None = None,
) -> Iterator[Callable[[], bool]]:
    """Serve the page from a listening socket, in threads, while the block runs.

    Yields a function that returns True if all threads are alive.

    names: accepted host names, besides IP addresses.
    is_public: whether other machines can connect; then the API needs a login.
    progress: receives the progress of the threads.
    login: None for a page without a password.
    """
    # Progress marks, bus followers, HTTP server.
    marks = progress or Progress()
    page, feeding = (marks.watch(name, STALL_SECONDS) for name in ("page", "feed"))
    stop = threading.Event()
    page_queues = PageQueues()
    feed = Feed(bus, page_queues, clock, config.cameras)
    api = Api(bus, feed, is_open=login is not None or not is_public)
    site = Routes(feed, page_queues, config, login is not None, bus)
    settings = uvicorn.Config(
        application(site, api, names, login, page.beat),
        log_config=None,
        log_level="error",  # not each invalid request
        access_log=False,
        lifespan="on",
        server_header=False,
        timeout_graceful_shutdown=CLOSE_SECONDS,
        http=HttpConnection,
        proxy_headers=False,  # any client can write them
    )
    server = uvicorn.Server(settings)

    # One thread for each.
    threads = [
        threading.Thread(target=server.run, args=[[listener]], name="page", daemon=True),
        threading.Thread(target=feed.follow, args=[stop, feeding.beat], name="feed", daemon=True),
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


def _file(path: str | Path) -> Response:
    """Return the response with a file, or that there is none; "" is no file."""
    if not os.access(path, os.R_OK):
        return error(404, "there is no such file")
    return FileResponse(path)
