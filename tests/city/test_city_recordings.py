"""Splitting a recording by district, and fits in processes of this machine."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from city_recording import DISTRICTS, EVENTS
from dying_fits import fit_or_die, tries
from msgspec.structs import replace

from camtopod.city import recordings
from camtopod.city.recordings import CityError, in_process, learn_city, split
from camtopod.codec import event_from_json
from camtopod.learn.recording import learn_topology

Submit = Callable[..., Future[None]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the events by district."""
    folder = tmp_path / "parts"
    split(EVENTS, DISTRICTS, folder)
    return folder


@pytest.fixture
def threads() -> Iterator[ThreadPoolExecutor]:
    """Return two threads, each with a process at a time."""
    with ThreadPoolExecutor(2) as threads:
        yield threads


def killing(threads: ThreadPoolExecutor, kills: int) -> Submit:
    """Return what has districts learned: d1 in processes, of which it kills the first."""
    fit = partial(fit_or_die, "d1", kills)

    def submit(function: Callable[..., None], path: Path, name: str, *rest: Any) -> Future[None]:
        if name == "d1":
            return threads.submit(in_process, fit, path, name, *rest)
        return threads.submit(function, path, name, *rest)

    return submit


def test_each_district_has_the_events_that_it_hears(tmp_path: Path) -> None:
    stranger = replace(EVENTS[0], camera="yard")
    folder = tmp_path / "parts"

    split([stranger, *EVENTS], DISTRICTS, folder, lambda: b"a note")

    assert [*tmp_path.iterdir()] == [folder]
    assert (folder / recordings.NOTE).read_bytes() == b"a note"
    assert any(district.hears for district in DISTRICTS.values())
    for name, district in DISTRICTS.items():
        lines = (folder / f"{name}.jsonl").read_bytes().splitlines()
        cameras = {*district.cameras, *district.hears}
        assert [*map(event_from_json, lines)] == [e for e in EVENTS if e.camera in cameras]


def test_a_split_that_ends_early_leaves_nothing(tmp_path: Path) -> None:
    def events() -> Iterator[Any]:
        yield from EVENTS[:1000]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        split(events(), DISTRICTS, tmp_path / "parts")

    assert [*tmp_path.iterdir()] == []


def test_a_killed_process_costs_its_fit_only(folder: Path, threads: ThreadPoolExecutor) -> None:
    counts: list[int] = []

    city = learn_city(killing(threads, 1), (), DISTRICTS, folder, on_progress=counts.append)

    assert {name: tries(folder, name) for name in DISTRICTS} == {"d0": 1, "d1": 2, "d2": 1}
    assert counts == sorted(counts)
    assert counts[-1] == len(DISTRICTS)
    for part in city.topology.parts or ():
        district = DISTRICTS[part.site]
        cameras = {*district.cameras, *district.hears}
        events = [event for event in EVENTS if event.camera in cameras]
        assert part == learn_topology(events, site=part.site)


def test_a_district_that_kills_three_processes_ends_the_run(
    folder: Path, threads: ThreadPoolExecutor
) -> None:
    with pytest.raises(CityError, match=r"^district d1: 3 processes ended while they learned it"):
        learn_city(killing(threads, 3), (), DISTRICTS, folder)
    assert tries(folder, "d1") == 3
    before = (folder / "d0.0.json").stat()

    learn_city(killing(threads, 0), (), DISTRICTS, folder)  # goes on with what is missing

    assert tries(folder, "d1") == 1
    assert (folder / "d0.0.json").stat().st_mtime_ns == before.st_mtime_ns


def test_a_process_that_never_begins_is_not_tried_for_ever() -> None:
    with pytest.raises(CityError, match="its processes end before they begin"):
        in_process(signal.raise_signal, signal.SIGKILL)


def test_a_district_without_events_is_named(tmp_path: Path, threads: ThreadPoolExecutor) -> None:
    silent = DISTRICTS["d2"].cameras
    deaf = {name: replace(district, hears=()) for name, district in DISTRICTS.items()}
    events = [event for event in EVENTS if event.camera not in silent]

    with pytest.raises(CityError, match=r"^district d2: no events"):
        learn_city(threads.submit, events, deaf, tmp_path / "parts")


def test_a_fit_that_never_ends_has_a_limit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks: list[Future[None]] = []

    def submit(*_: Any) -> Future[None]:
        tasks.append(Future())
        return tasks[-1]

    monkeypatch.setattr(recordings, "QUIET_SECONDS_MAX", 0.0)
    with pytest.raises(CityError, match="no district was done within 0 s"):
        learn_city(submit, (), DISTRICTS, folder)

    assert all(task.cancelled() for task in tasks)
    tasks[0].set_running_or_notify_cancel()  # as of a scheduler that has gone
    with pytest.raises(CityError, match=r"district d[0-2]: it was cancelled"):
        learn_city(lambda *_: tasks[0], (), DISTRICTS, folder)
