"""Fits on a real Dask cluster, some of which kill their worker."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path

import dask
import pytest
from city_recording import DISTRICTS, EVENTS
from distributed import Client, LocalCluster
from dying_fits import tries
from dying_workers import Killing
from threadpoolctl import threadpool_info

from camtopod.city import cluster
from camtopod.city.cluster import learn_city, submitting
from camtopod.city.recordings import CityError, split
from camtopod.learn.recording import learn_topology

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Restore, at the end, what a `LocalCluster` sets in its own process."""
    for name in THREADS:
        monkeypatch.setenv(name, "1")


@contextmanager
def made_here(workers: int = 2, threads: int = 1, processes: bool = True) -> Iterator[Client]:
    """Return the client of a cluster of this machine, of processes or threads."""
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=processes,
            dashboard_address=":0",
        ) as local,
        Client(local, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture
def client() -> Iterator[Client]:
    """Return the client of a cluster of two processes."""
    with made_here() as client:
        yield client


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the events by district."""
    folder = tmp_path / "parts"
    split(EVENTS, DISTRICTS, folder)
    return folder


def test_a_killed_worker_costs_its_fit_only(client: Client, tmp_path: Path) -> None:
    counts: list[int] = []
    folder = tmp_path / "parts"
    client.register_plugin(Killing(folder, "d1", 1))

    city = learn_city(client, EVENTS, DISTRICTS, folder, on_progress=counts.append)

    assert {name: tries(folder, name) for name in DISTRICTS} == {"d0": 1, "d1": 2, "d2": 1}
    assert counts[-1] == len(DISTRICTS)
    for part in city.topology.parts or ():
        district = DISTRICTS[part.site]
        cameras = {*district.cameras, *district.hears}
        events = [event for event in EVENTS if event.camera in cameras]
        assert part == learn_topology(events, site=part.site)


def test_a_district_that_kills_three_workers_ends_the_run(client: Client, folder: Path) -> None:
    client.register_plugin(Killing(folder, "d1", 3))

    with pytest.raises(CityError, match=r"^district d1: 3 processes ended while they learned it"):
        learn_city(client, (), DISTRICTS, folder)

    assert tries(folder, "d1") == 3


def test_a_scheduler_that_gives_up_earlier_ends_the_run(folder: Path) -> None:
    """There a worker's end counts against all tasks that the worker had, begun or not."""
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), made_here() as client:
        client.register_plugin(Killing(folder, "d1", 3))

        with pytest.raises(CityError, match=r"^district d\d: Attempted to run task"):
            learn_city(client, (), DISTRICTS, folder)


def count_threads(path: Path) -> None:
    """Write the numbers of threads of linear algebra."""
    path.write_text(str({library["num_threads"] for library in threadpool_info()}))


def test_a_task_has_one_thread_of_linear_algebra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in THREADS:
        monkeypatch.setenv(name, "2")
    with made_here(1) as client:
        client.submit(count_threads, tmp_path / "before").result(60)
        submitting(client)(count_threads, tmp_path / "threads").result(60)

    assert (tmp_path / "before").read_text() == "{2}"
    assert (tmp_path / "threads").read_text() == "{1}"


def test_workers_of_many_threads_are_refused() -> None:
    refused = pytest.raises(CityError, match="has 2 threads: start it with")
    with made_here(1, 2, processes=False) as client, refused:
        submitting(client)


def test_versions_are_compared(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions = client.get_versions(packages=[*cluster.WORKER_PACKAGES])
    other = deepcopy(versions)
    worker = [*other["workers"]][1]
    other["workers"][worker]["packages"]["camtopod"] = None
    other["workers"][worker]["host"]["python"] = "3.0.7.final.0"
    other["scheduler"]["packages"]["toolz"] = "0.1"
    other["scheduler"]["packages"]["numpy"] = None  # it needs none
    here = versions["client"]
    sentences = [
        f"the scheduler has toolz 0.1, this process {here['packages']['toolz']}",
        f"{worker} has python 3.0, this process {here['host']['python'].rsplit('.', 3)[0]}",
        f"{worker} has camtopod None, this process {here['packages']['camtopod']}",
    ]

    assert [*cluster.differences(versions)] == []
    assert [*cluster.differences(other)] == sentences
    with monkeypatch.context() as patch:
        patch.setattr(client, "get_versions", lambda packages: other)
        with pytest.raises(CityError) as error:
            learn_city(client, EVENTS, DISTRICTS, tmp_path / "parts")
    assert str(error.value).splitlines()[1:] == sentences
    assert [*tmp_path.iterdir()] == []

    # And of a worker that has come later.
    monkeypatch.setattr(cluster, "__version__", "0.0.9")
    with pytest.raises(CityError, match=r"has camtopod .*, this process 0\.0\.9$"):
        learn_city(client, EVENTS, DISTRICTS, tmp_path / "parts")


def test_a_cluster_without_workers_has_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "WORKER_SECONDS", 0.1)
    with made_here(0) as client, pytest.raises(TimeoutError):
        learn_city(client, EVENTS, DISTRICTS, tmp_path / "parts")
