"""Read-only HTTP API of the page's server, for programs in any language.

`deploy/page.md` lists its routes. Predictions and matches are streamed as server-sent
events.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from typing import Any

import anyio.to_thread
import msgspec
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from camtopod import codec
from camtopod.records import Match, Prediction
from camtopod.serve.bus import JSON, Bus, QueryError
from camtopod.serve.city_bus import CityBus
from camtopod.serve.live_predictions import asked_exit
from camtopod.topology import UnknownPlace
from camtopod.web.feed import Feed
from camtopod.web.outbox import PageQueues

ASKED = ("zone", "x", "y", "t", "now", "label")
"""Parameters of a query for a prediction beside ``camera``."""
LOOPBACK_ONLY = (
    "this API answers programs on its own machine only: set [web] password_file and token_file, "
    "or let camtopod web listen on 127.0.0.1"
)
ASKING_MAX = 32
"""Requests that wait for the daemon at a time; further ones are refused."""
_STREAMED: dict[str, type[Prediction | Match]] = {"prediction": Prediction, "match": Match}
"""Records of the streams, by the first part of their keys on the bus."""
_EVERY_CAMERA = "*"
"""Stands for all cameras; no camera has this id."""


Handler = Callable[[Request], Response]


class Asking:
    """Threads of their own for handlers that wait for the daemon, and so delay no other.

    count: how many may wait at a time; further requests are refused.
    """

    def __init__(self, count: int) -> None:
        self._limiter = anyio.CapacityLimiter(count)
        self._free = count

    def __call__(self, handler: Handler) -> Callable[[Request], Awaitable[Response]]:
        """Return the handler as one that waits in these threads."""

        async def handle(request: Request) -> Response:
            if not self._free:
                return error(503, "too many requests wait for the daemon: try again later")
            self._free -= 1
            try:
                return await anyio.to_thread.run_sync(handler, request, limiter=self._limiter)
            finally:
                self._free += 1

        return handle


class Api:
    """Handlers of the API.

    is_open: whether requests are answered at all, as only this machine can make them or as they
        carry a token.
    """

    def __init__(self, bus: Bus | CityBus, feed: Feed, is_open: bool) -> None:
        self._bus = bus
        self._feed = feed
        self._is_open = is_open
        self.asking = Asking(ASKING_MAX)
        """Of the handlers that ask the daemon."""
        self._readers = {kind: PageQueues() for kind in _STREAMED}
        for kind in _STREAMED:
            bus.subscribe(f"{kind}/*", self._on_answer)

    def routes(self) -> list[Route]:
        """Return the routes of the API."""
        if not self._is_open:
            return [Route("/api/{any}", lambda request: error(403, LOOPBACK_ONLY))]
        return [
            Route("/api/topology", self.asking(self.topology)),
            Route("/api/versions", self.versions),
            Route("/api/status", self.status),
            Route("/api/predict", self.asking(self.predict)),
            Route("/api/predictions", self.predictions),
            Route("/api/walks", self.walks),
            Route("/api/matches", self.matches),
        ]

    def close(self) -> None:
        """End all streams."""
        for readers in self._readers.values():
            readers.close()

    def topology(self, request: Request) -> Response:
        """Return the newest topology, or with ``version`` an older one of its epoch."""
        newest = self._feed.topology
        if newest is None:
            return error(404, "nothing has been learned yet")
        version = request.query_params.get("version", str(newest.version))
        if version == str(newest.version):
            return content(newest)
        return self._asked("topology", {"epoch": newest.epoch, "version": version}, 404)

    def versions(self, request: Request) -> Response:
        """Return summaries of the versions since this server began, oldest first."""
        return content(self._feed.versions)

    def recent(self, request: Request) -> Response:
        """Return the events of the last hour, without tracks."""
        return self._asked("recent", {}, 400)

    def hours(self, request: Request) -> Response:
        """Return entries and exits of each camera by the hour, for a day."""
        return self._asked("recent", {"since": "inf", "hours": "1"}, 400)

    def status(self, request: Request) -> Response:
        """Return state, reason and counters of the daemon and of all cameras."""
        return content(self._feed.health())

    def predict(self, request: Request) -> Response:
        """Return the daemon's prediction for an exit: `ASKED` are those of ``predict/{camera}``."""
        parameters = dict(request.query_params)
        camera = parameters.pop("camera", "")
        if unknown := sorted(set(parameters) - set(ASKED)):
            return error(400, f"unknown parameter {unknown[0][:20]!r}: use {', '.join(ASKED)}")
        try:
            asked_exit(camera, parameters, 0.0)
        except QueryError as refusal:
            return error(400, str(refusal))
        newest, names = self._feed.topology, self._feed.names()
        if newest is not None and camera not in names:
            return error(404, str(UnknownPlace("camera", camera, newest.version, sorted(names))))
        return self._asked(f"predict/{camera}", parameters, 400)

    async def predictions(self, request: Request) -> Response:
        """Stream the daemon's predictions, of all exits or those of ``camera``."""
        return self._stream("prediction", request)

    async def matches(self, request: Request) -> Response:
        """Stream the daemon's matches, of all entries or those of ``camera``."""
        return self._stream("match", request)

    def walks(self, request: Request) -> Response:
        """Return the newest match of each entry later than ``since``, at most an hour ago."""
        try:
            since = float(request.query_params.get("since", "-inf"))
        except ValueError:
            return error(400, "since: Unix seconds")
        return content(self._feed.walks(since))

    def _stream(self, kind: str, request: Request) -> Response:
        """Stream the records of a kind, all or those of ``camera``."""
        camera = request.query_params.get("camera", _EVERY_CAMERA)
        if camera != _EVERY_CAMERA and not codec.is_camera(camera):
            return error(400, "camera: the id of a camera")
        readers = self._readers[kind]
        page_queue = readers.open(camera)
        if page_queue is None:
            return error(503, "too many programs read this stream")

        return streamed(readers.messages(page_queue, lambda: b": still here\n\n"))

    def _asked(self, key: str, parameters: dict[str, str], status: int) -> Response:
        """Return the daemon's answer to a query; ``status`` is that of a refusal."""
        if any(set(value) & set(";=&?#") for value in parameters.values()):
            return error(400, "a parameter is an id of the topology or a number")
        try:
            answers = self._bus.query(key, {**parameters, "format": JSON}, one=True)
        except QueryError as refusal:
            return error(status, str(refusal))
        if not answers:
            return error(503, "the daemon does not answer")
        return content(msgspec.Raw(answers[0][1]))

    def _on_answer(self, key: str, payload: bytes) -> None:
        """Pass a prediction or match on to the programs that read; a slow one misses some."""
        kind = key.partition("/")[0]
        with contextlib.suppress(codec.Rejected):
            answer = codec.read(_STREAMED[kind], payload, pack=True)
            line = codec.to_json(answer)
            for camera in (answer.camera, _EVERY_CAMERA):
                self._readers[kind].send("", line, camera, is_optional=True)


def streamed(messages: AsyncIterator[bytes]) -> Response:
    """Return the response with server-sent events, which no proxy may hold back (nginx would)."""
    headers = {"X-Accel-Buffering": "no"}
    return StreamingResponse(messages, headers=headers, media_type="text/event-stream")


def content(value: Any) -> Response:
    """Return the response with a value, in JSON."""
    return Response(codec.to_json(value), media_type="application/json")


def error(status: int, reason: str, headers: Mapping[str, str] | None = None) -> Response:
    """Return the response that says what is wrong."""
    return JSONResponse({"error": reason}, status, headers)
