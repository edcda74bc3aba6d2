"""`camtopod.client` for asyncio: the same interface, with waiting methods awaited.

    async with aio.Site.connect("hq") as site:
        async for prediction in site.predictions():
            print(prediction.camera, "->", prediction)

Waiting does not occupy a thread, but in `Site.between`.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Callable, Sequence
from functools import partial
from typing import TypeVar

from camtopod.client.answer_queue import AnswerQueue, AnswerT
from camtopod.client.site_view import Settings, SiteView
from camtopod.client.wakeup import ChangeSignal
from camtopod.records import Between, Match, Prediction, Topology

T = TypeVar("T")


class Site(SiteView):
    """As `camtopod.client.Site`; methods that do not wait, such as `predict`, are not async."""

    @classmethod
    @contextlib.asynccontextmanager
    async def connect(
        cls, site: str | None = None, connect: str | Sequence[str] = (), config: Settings = None
    ) -> AsyncIterator[Site]:
        """Connect for the duration of an ``async with`` block.

        Arguments and errors are those of `camtopod.client.Site.connect`.
        """
        sites: list[Site] = []
        given_up = threading.Event()

        def open_here() -> None:
            sites.append(cls(site, connect, config))
            if given_up.is_set():
                sites[0].close()

        # Connecting blocks, so it runs in a thread, which cannot be stopped: it closes the
        # connection itself if this is cancelled meanwhile.
        try:
            await asyncio.to_thread(open_here)
            yield sites[0]
        finally:
            given_up.set()
            for connection in sites:
                await asyncio.to_thread(connection.close)

    async def wait_for(self, version: int, seconds: float) -> Topology:
        """Return the newest version as soon as its number is at least ``version``.

        Raises TimeoutError after ``seconds``, or if closed meanwhile.
        """
        topology = await _awaited(self._news, lambda: self._at_least(version), seconds)
        if topology is None:
            raise TimeoutError(self._not_there(version, seconds))
        return topology

    async def versions(self, seconds: float | None = None) -> AsyncIterator[Topology]:
        """Yield the current version, if there is one, and each later one.

        See `camtopod.client.Site.versions`.
        """
        last = None
        while (last := await _awaited(self._news, partial(self._newer, last), seconds)) is not None:
            yield last

    def predictions(
        self, camera: str | None = None, seconds: float | None = None
    ) -> Answers[Prediction]:
        """Subscribe to the daemon's own predictions.

        See `camtopod.client.Site.predictions`.
        """
        return self._opened(lambda bus: Answers(bus, Prediction, camera, seconds))

    def walks(self, camera: str | None = None, seconds: float | None = None) -> Answers[Match]:
        """Subscribe to the daemon's matches. See `camtopod.client.Site.walks`."""
        return self._opened(lambda bus: Answers(bus, Match, camera, seconds))

    async def between(self) -> Between | None:
        """Ask how many objects are between cameras. See `camtopod.client.Site.between`."""
        return await asyncio.to_thread(self._between)


class Answers(AnswerQueue[AnswerT], contextlib.AbstractAsyncContextManager["Answers[AnswerT]"]):
    """As `camtopod.client.Answers`, for ``async for``; ``async with`` closes it."""

    async def get(self, seconds: float | None = None) -> AnswerT | None:
        """Return the next answer; None if none arrives within ``seconds``, or when closed."""
        return await _awaited(self._news, self._take, seconds)

    async def __aiter__(self) -> AsyncIterator[AnswerT]:
        while (answer := await self.get(self._seconds)) is not None:
            yield answer

    async def __aexit__(self, *_: object) -> None:
        self.close()


async def _awaited(
    news: ChangeSignal, search: Callable[[], T | None], seconds: float | None
) -> T | None:
    """Do what `ChangeSignal.wait_for` does, in an event loop."""
    loop = asyncio.get_running_loop()
    signal = asyncio.Event()

    def tell() -> None:
        with contextlib.suppress(RuntimeError):  # raised if the loop has been closed meanwhile
            loop.call_soon_threadsafe(signal.set)

    with news.listener_added(tell), contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            while not news.is_closed:
                if (value := search()) is not None:
                    return value
                await signal.wait()
                signal.clear()
    return None
