"""Print versions and predictions as they are published: `python in_asyncio.py [ENDPOINT]`."""

import asyncio
import sys

from camtopod.client import aio


async def main(connect: list[str], seconds: float | None = None) -> None:
    """Follow both until nothing has come for ``seconds``."""
    async with aio.Site.connect(connect=connect) as site, asyncio.TaskGroup() as group:
        group.create_task(versions(site, seconds))
        group.create_task(predictions(site, seconds))


async def versions(site: aio.Site, seconds: float | None) -> None:
    async for version in site.versions(seconds):
        print(f"version {version.version}: {len(version.pairs)} pairs of cameras", flush=True)


async def predictions(site: aio.Site, seconds: float | None) -> None:
    async for said in site.predictions(seconds=seconds):
        print(f"{said.camera} -> {said}", flush=True)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
