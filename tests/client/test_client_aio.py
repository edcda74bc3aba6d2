"""The client library in asyncio: as in threads, and waits and connections can be cancelled."""

from __future__ import annotations

import asyncio
import time

import pytest
from fake_bus_daemon import LEFT, LearnedDaemon, there

from camtopod.client import aio


def test_asyncio_has_the_same(learned_daemon: LearnedDaemon) -> None:
    async def main() -> None:
        async with aio.Site.connect(connect=learned_daemon.daemon.endpoint) as site:
            assert site.stale_since is None
            assert site.predict(**LEFT).next
            assert await site.wait_for(1, 0.0) is site.current
            with pytest.raises(TimeoutError, match="no version 1000000"):
                await site.wait_for(10**6, 0.05)
            versions = [one.version async for one in site.versions(seconds=0.05)]
            assert versions[0] >= 1
            async with site.predictions("b", seconds=0.5) as predictions:
                there(site)
                exits = [
                    e.t for e in learned_daemon.walks(4, 16) if e.kind == "exit" and e.camera == "b"
                ]
                heard = [await predictions.get(20.0) for _ in exits]
                assert [prediction and prediction.t for prediction in heard] == exits
                assert [prediction async for prediction in predictions] == []
            async with site.walks("b", seconds=0.05) as matches:
                assert [match async for match in matches] == []
            assert await site.between() is not None
        assert [one.version async for one in site.versions()] == []

    asyncio.run(main())


def test_what_waits_in_asyncio_can_be_cancelled(learned_daemon: LearnedDaemon) -> None:
    async def main() -> tuple[float, int]:
        async with aio.Site.connect(connect=learned_daemon.daemon.endpoint) as site:
            waiting = [
                asyncio.create_task(site.wait_for(10**6, 60.0)),
                asyncio.create_task(site.predictions().get()),
            ]
            await asyncio.sleep(0)
            for task in waiting:
                task.cancel()
            started = time.monotonic()
            await asyncio.wait(waiting)
            assert all(task.cancelled() for task in waiting)
            return time.monotonic() - started, len(site._news._listeners)

    seconds, listeners = asyncio.run(main())
    assert seconds < 30.0
    assert listeners == 0
