"""The client library in asyncio: as in threads, and waits and connections can be cancelled."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_bus_daemon import LEFT, Hub, a_hub, there
from serving import free_endpoint

from camtopod.client import BusError, aio, site_view
from camtopod.config.settings import BusSettings, Config
from camtopod.serve.bus.session import Bus, dial


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hub]:
    with a_hub(tmp_path_factory.mktemp("hub")) as one:
        yield one


def test_asyncio_has_the_same(hub: Hub) -> None:
    async def main() -> None:
        async with aio.Topology.connect(connect=hub.daemon.endpoint) as site:
            assert site.stale_since is None
            assert site.predict(**LEFT).next_
            assert await site.wait_for(1, 0.0) is site.current
            with pytest.raises(TimeoutError, match="no version 1000000"):
                await site.wait_for(10**6, 0.05)
            versions = [one.version async for one in site.versions(seconds=0.05)]
            assert versions[0] >= 1
            async with site.predictions("b", seconds=0.5) as predictions:
                there(site)
                exits = [e.t for e in hub.walks(4, 16) if e.kind == "exit" and e.camera == "b"]
                assert [p.t async for p in predictions] == exits
                assert await predictions.get(0.0) is None
        assert [one.version async for one in site.versions()] == []

    asyncio.run(main())


def test_what_waits_in_asyncio_can_be_cancelled(hub: Hub) -> None:
    async def main() -> tuple[float, int]:
        async with aio.Topology.connect(connect=hub.daemon.endpoint) as site:
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
    assert seconds < 5.0
    assert listeners == 0


def test_asyncio_says_that_nobody_is_there(tmp_path: Path) -> None:
    config = Config(bus=BusSettings(connect=(free_endpoint(),), connect_seconds=0.2))

    async def main() -> None:
        async with aio.Topology.connect(config=config):
            raise AssertionError

    with pytest.raises(BusError, match="cannot reach the bus"):
        asyncio.run(main())


def test_a_connection_that_is_given_up_is_closed(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    closed = []
    monkeypatch.setattr(
        aio.Topology, "close", lambda self: (closed.append(self), super(aio.Topology, self).close())
    )

    async def main() -> None:
        async def hold() -> None:
            async with aio.Topology.connect(connect=hub.daemon.endpoint):
                await asyncio.sleep(60)

        task = asyncio.create_task(hold())
        await asyncio.sleep(0)  # the thread has begun to dial
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(main())
    assert len(closed) == 1


def test_giving_up_twice_leaves_nothing_open(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    dialling, go_on, opened = threading.Event(), threading.Event(), []

    def slowly(config: Config) -> Bus:
        dialling.set()
        assert go_on.wait(10.0)
        opened.append(dial(config))
        return opened[-1]

    monkeypatch.setattr(site_view, "dial", slowly)

    async def main() -> None:
        task = asyncio.create_task(aio.Topology.connect(connect=hub.daemon.endpoint).__aenter__())
        await asyncio.to_thread(dialling.wait)
        for _ in range(2):
            task.cancel()
            await asyncio.sleep(0)
        with pytest.raises(asyncio.CancelledError):
            await task
        go_on.set()

    asyncio.run(main())  # waits for its threads
    closed = [one.connected for one in opened] == [False]
    for one in opened:
        one.close()
    assert closed


def test_giving_up_is_not_hidden_by_what_went_wrong_meanwhile() -> None:
    async def main() -> None:
        task = asyncio.create_task(aio.Topology.connect(connect="nonsense").__aenter__())
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(main())
