"""Read-only HTTP API of the page's server, for programs in any language.

`deploy/page.md` lists its routes. Predictions are streamed as server-sent events.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import AsyncIterator

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from camtopod import codec
from camtopod.records import CAMERA_PATTERN, Prediction
from camtopod.serve.bus import Bus, QueryError
from camtopod.web.feed import Feed
from camtopod.web.outbox import PageQueues

ASKED = ("zone", "x", "y", "t", "now")
"""Parameters of a query for a prediction beside ``camera``."""
LOOPBACK_ONLY = (
    "this API answers programs on its own machine only: set [web] password_file and token_file, "
    "or let camtopod web listen on 127.0.0.1"
)
_EVERY_CAMERA = "*"
"""Stands for all cameras; no camera has this id."""
_VERSION = re.compile("[0-9]{1,18}")
"""As many digits as the daemon accepts."""


class Api:
    """Handlers of the API.

    is_open: whether requests are answered at all, as only this machine can make them or as they
        carry a token.
    """

    def __init__(self, bus: Bus, feed: Feed, is_open: bool) -> None:
        self._bus = bus
        self._feed = feed
        self._is_open = is_open
        self._readers = PageQueues()
        bus.subscribe("prediction/*", self._on_prediction)

    def routes(self) -> list[Route]:
        """Return the routes of the API."""
        if not self._is_open:
            return [Route("/api/{any}", lambda request: _error(403, LOOPBACK_ONLY))]
        return [
            Route("/api/topology", self.topology),
            Route("/api/versions", self.versions),
            Route("/api/status", self.status),
            Route("/api/predict", self.predict),
            Route("/api/predictions", self.predictions),
        ]

    def close(self) -> None:
        """End all streams."""
        self._readers.close()

    def topology(self, request: Request) -> Response:
        """Return the newest topology, or with ``version`` an older one of its epoch."""
        newest = self._feed.topology
        if newest is None:
            return _error(404, "nothing has been learned yet")
        number = request.query_params.get("version", str(newest.version))
        if not _VERSION.fullmatch(number):
            return _error(400, f"version {number[:20]!r} is not a whole number")
        if int(number) == newest.version:
            return _content(codec.to_json(newest))
        asked = {"epoch": newest.epoch, "version": int(number)}
        try:
            answers = self._bus.query("topology", asked, one=True)
            found = [codec.decode_topology(payload, pack=True) for _, payload in answers]
        except (QueryError, codec.Rejected):
            found = []
        if not found:
            return _error(404, f"version {number} is not kept, or the daemon does not answer")
        return _content(codec.to_json(found[0]))

    def versions(self, request: Request) -> Response:
        """Return summaries of the versions since this server began, oldest first."""
        return _content(codec.to_json(self._feed.versions))

    def status(self, request: Request) -> Response:
        """Return state, reason and counters of the daemon and of all cameras."""
        return _content(codec.to_json(self._feed.health()))

    def predict(self, request: Request) -> Response:
        """Return the daemon's prediction for an exit: `ASKED` are those of ``predict/{camera}``."""
        given = dict(request.query_params)
        camera = given.pop("camera", "")
        if not re.match(CAMERA_PATTERN, camera):
            return _error(400, "camera: the id of the camera whose view the object left")
        if unknown := sorted(set(given) - set(ASKED)):
            return _error(400, f"unknown parameter {unknown[0][:20]!r}: use {', '.join(ASKED)}")
        if any(set(value) & set(";=&?#") for value in given.values()):
            return _error(400, "zone is an id of the topology; the others are numbers")

        try:
            answers = self._bus.query(f"predict/{camera}", given, one=True)
        except QueryError as error:
            return _error(400, str(error))
        if not answers:
            return _error(503, "the daemon does not answer")
        return _content(codec.to_json(codec.read(Prediction, answers[0][1], pack=True)))

    async def predictions(self, request: Request) -> Response:
        """Stream the daemon's predictions, of all exits or those of ``camera``."""
        camera = request.query_params.get("camera", _EVERY_CAMERA)
        if camera != _EVERY_CAMERA and not re.match(CAMERA_PATTERN, camera):
            return _error(400, "camera: the id of a camera")
        page_queue = self._readers.open(camera)
        if page_queue is None:
            return _error(503, "too many programs read predictions")

        async def stream() -> AsyncIterator[bytes]:
            with contextlib.ExitStack() as stack:
                stack.callback(self._readers.leave, page_queue)
                yield b"retry: 1000\n\n"
                while (message := await page_queue.take()) is not None:
                    yield message or b": still here\n\n"

        return StreamingResponse(stream(), media_type="text/event-stream")

    def _on_prediction(self, key: str, payload: bytes) -> None:
        """Pass a prediction on to the programs that read; a slow one misses some."""
        if not self._readers:
            return
        try:
            prediction = codec.read(Prediction, payload, pack=True)
        except codec.Rejected:
            return
        content = codec.to_json(prediction)
        for camera in (prediction.camera, _EVERY_CAMERA):
            self._readers.send("prediction", content, camera, passing=True)


def _content(json: bytes) -> Response:
    return Response(json, media_type="application/json")


def _error(status: int, what: str) -> Response:
    return JSONResponse({"error": what}, status)
