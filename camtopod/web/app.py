"""The page's server, the one home of starlette and uvicorn: reads only, and everything comes from this machine."""

from __future__ import annotations

import contextlib
import re
import socket
import threading
from collections.abc import AsyncIterator
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from camtopod.records import CAMERA_PATTERN, Topology
from camtopod.web import stories
from camtopod.web.feed import Feed
from camtopod.web.history import changes
from camtopod.web.mailbox import Hub
from camtopod.web.past import Past
from camtopod.web.pictures import picture_of

BEAT_SECONDS = 4.0
"""A page hears something at least as often."""
CONNECTIONS_MAX = 256
CLOSE_SECONDS = 2
HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}
STATIC = resources.files("camtopod.web") / "static"


class _Strict:
    """Adds `HEADERS` to every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def strict(message: Message) -> None:
            if message["type"] == "http.response.start":
                added = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                message = {**message, "headers": [*message["headers"], *added]}
            await send(message)

        await self._app(scope, receive, strict)


class Site:
    """What the routes answer from."""

    def __init__(self, feed: Feed, past: Past, hub: Hub, pictures: Path | None) -> None:
        self._feed, self._past, self._hub, self._pictures = feed, past, hub, pictures

    def map(self, request: Request) -> Response:
        """The newest version's map; null if nothing has been learned."""
        return Response(self._feed.map_json, media_type="application/json")

    def health(self, request: Request) -> Response:
        """State and reason of the daemon and of every camera."""
        return _json(self._feed.health())

    def camera(self, request: Request) -> Response:
        """One camera's zones and links, and whether there is a picture."""
        name = request.path_params["camera"]
        story = None if self._feed.topology is None else stories.camera_story(self._feed.topology, name)
        if story is None:
            return _json({"error": f"camera {name} has not been learned yet"}, 404)
        return _json({**story, "picture": picture_of(self._pictures, name) is not None})

    def pair(self, request: Request) -> Response:
        """The links between two cameras."""
        a, b = request.path_params["a"], request.path_params["b"]
        story = None if self._feed.topology is None else stories.pair_story(self._feed.topology, a, b)
        return _json(story) if story else _json({"error": f"nothing joins {a} and {b} in the newest version"}, 404)

    def link(self, request: Request) -> Response:
        """One link: ``from``, ``to``, ``relation``."""
        key = [request.query_params.get(name, "") for name in ("from", "to", "relation")]
        story = None if self._feed.topology is None else stories.link_story(self._feed.topology, *key)
        return _json(story) if story else _json({"error": f"{key[0]} → {key[1]} is not in the newest version"}, 404)

    def versions(self, request: Request) -> Response:
        """Summaries of the versions known without asking, and the newest version."""
        newest = self._feed.topology
        return _json([] if newest is None else self._past.summaries(newest))

    def version(self, request: Request) -> Response:
        """A version's summary, which the daemon may have to be asked for."""
        newest, number = self._feed.topology, request.path_params["version"]
        found = None if newest is None else self._past.summary(newest, number)
        return _json(found) if found else _not_kept(number)

    def changes(self, request: Request) -> Response:
        """What changed from version ``old`` to ``new``."""
        newest = self._feed.topology
        numbers = request.path_params["old"], request.path_params["new"]
        found: list[Topology] = []
        for number in numbers:
            one = None if newest is None else self._past.version(newest, number)
            if one is None:
                return _not_kept(number)
            found.append(one)
        return _json(changes(*found))

    def picture(self, request: Request) -> Response:
        """A camera's picture, if there is one in the folder."""
        path = picture_of(self._pictures, request.path_params["camera"])
        if path is None:
            return _json({"error": "no picture"}, 404)
        return FileResponse(path, headers={"cache-control": "no-cache"})

    async def live(self, request: Request) -> Response:
        """Server-sent events: what is new, and with ``camera`` that one's entries and exits."""
        camera = request.query_params.get("camera")
        if camera is not None and not re.match(CAMERA_PATTERN, camera):
            return _json({"error": "no such camera"}, 404)
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

        return StreamingResponse(stream(), media_type="text/event-stream", headers={"cache-control": "no-store"})


def application(site: Site, hosts: list[str]) -> Starlette:
    """The application; it answers to the names ``hosts`` only (``*``: to any)."""
    routes = [
        Route("/", lambda request: FileResponse(str(STATIC / "index.html"), headers={"cache-control": "no-cache"})),
        Route("/data/map", site.map),
        Route("/data/health", site.health),
        Route("/data/camera/{camera}", site.camera),
        Route("/data/pair/{a}/{b}", site.pair),
        Route("/data/link", site.link),
        Route("/data/versions", site.versions),
        Route("/data/version/{version:int}", site.version),
        Route("/data/changes/{old:int}/{new:int}", site.changes),
        Route("/picture/{camera}", site.picture),
        Route("/live", site.live),
    ]
    middleware = [
        Middleware(_Strict),
        Middleware(TrustedHostMiddleware, allowed_hosts=hosts, www_redirect=False),
        Middleware(GZipMiddleware, minimum_size=1000, compresslevel=5),
    ]
    app = Starlette(routes=routes, middleware=middleware)
    app.mount("/static", StaticFiles(directory=str(STATIC)))
    return app


class Server:
    """Serves in a thread of its own from a socket that listens already."""

    def __init__(self, app: Starlette, listener: socket.socket) -> None:
        config = uvicorn.Config(
            app, log_config=None, log_level="warning", access_log=False, lifespan="off", server_header=False,
            limit_concurrency=CONNECTIONS_MAX, timeout_graceful_shutdown=CLOSE_SECONDS,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [listener]}, name="page", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """End within `CLOSE_SECONDS` or so; close the hub first."""
        self._server.should_exit = True
        self._thread.join(CLOSE_SECONDS + 1)


def _json(content: Any, status: int = 200) -> Response:
    headers = {"cache-control": "no-store"}
    return Response(msgspec.json.encode(content), status, headers, media_type="application/json")


def _not_kept(version: int) -> Response:
    return _json({"error": f"version {version} is not kept, or the daemon is not reached"}, 404)
