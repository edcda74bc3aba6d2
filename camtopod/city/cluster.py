"""The fits of districts as tasks of a Dask cluster, by the extra ``[city]``.

Workers get names and settings; events and topologies are files on a path that all of them see, as
a worker's memory is lost with it. A worker has one thread, so only its own task can end it, and one
thread of linear algebra, so digests are the same everywhere. Packages that differ can leave tasks
waiting without a word, so they are compared first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

from distributed import Client
from threadpoolctl import threadpool_limits

from camtopod import __version__
from camtopod.city import recordings
from camtopod.city.joined_map import JoinedMap
from camtopod.city.recordings import CityError
from camtopod.config import Districts
from camtopod.learn.settings import Settings
from camtopod.records import Event

WORKER_SECONDS = 60.0
"""Longest time until there is a worker."""
PACKAGES = ("python", "dask", "distributed", "cloudpickle", "msgpack", "toolz")
"""Packages that are the same everywhere; of Python the first two numbers."""
WORKER_PACKAGES = ("camtopod", "numpy", "scipy")
"""Packages that are the same here and on the workers."""


def learn_city(
    client: Client,
    events: Iterable[Event],
    districts: Districts,
    folder: Path,
    settings: Settings | None = None,
    site: str = "city",
    on_progress: Callable[[int], None] = lambda count: None,
) -> JoinedMap:
    """Learn a city as `recordings.learn_city`, on the workers of a cluster.

    folder: at a path that this process and all workers see.

    Raises CityError, ValueError as `merge`, and TimeoutError if there is no worker.
    """
    return recordings.learn_city(
        submitting(client), events, districts, folder, settings, site, on_progress
    )


def submitting(client: Client) -> Callable[..., Future[None]]:
    """Return a function that submits a call to the workers, and returns its future.

    Raises CityError if a process of the cluster is not as this one, and TimeoutError if there is no
    worker.
    """
    client.wait_for_workers(1, timeout=WORKER_SECONDS)
    if faults := [
        *differences(client.get_versions(packages=list(WORKER_PACKAGES))),
        *(
            f"{address} has {threads} threads: start it with --nthreads 1"
            for address, threads in client.nthreads().items()
            if threads != 1
        ),
    ]:
        raise CityError("\n".join(["this is not a cluster for camtopod:", *faults]))
    return partial(client.get_executor(pure=False).submit, _on_worker, __version__)


def differences(versions: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each package of which a process of a cluster has another version.

    versions: as `Client.get_versions` returns them.
    """
    own_packages = _packages(versions["client"])
    for place, process in {"the scheduler": versions["scheduler"], **versions["workers"]}.items():
        packages = _packages(process)
        for name in PACKAGES + WORKER_PACKAGES * (place != "the scheduler"):
            if packages[name] != own_packages[name]:
                yield f"{place} has {name} {packages[name]}, this process {own_packages[name]}"


def _packages(process: Mapping[str, Any]) -> dict[str, str | None]:
    """Return the version of each package of a process."""
    return {**process["packages"], "python": process["host"]["python"].rsplit(".", 3)[0]}


def _on_worker(version: str, function: Callable[..., None], *arguments: Any) -> None:
    """Call a function as a task; a worker that has come later may have another version."""
    if version != __version__:
        raise CityError(f"a worker has camtopod {__version__}, this process {version}")
    with threadpool_limits(1):
        function(*arguments)
