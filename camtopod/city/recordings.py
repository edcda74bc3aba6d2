"""A city from a recording: its events by district in files, a fit of each district, one topology.

A folder has a file of events for each district: of its own cameras, and of those that it hears. A
fit reads one of them and writes its topology beside it, so processes are handed names only, and one
that ends in the middle costs its own fit. A folder is there when its events are complete: a run
that was interrupted goes on. `camtopod.city.cluster` has the fits done by a cluster.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from camtopod import files
from camtopod.city.joined_map import JoinedMap
from camtopod.city.merge import merge
from camtopod.codec import event_from_json, load_topology, to_json
from camtopod.config import Districts
from camtopod.learn.recording import learn_in_order
from camtopod.learn.settings import Settings
from camtopod.records import Event

TRIES_MAX = 3
"""Largest number of fits of a district, in one run, during which the process ends."""
QUIET_SECONDS_MAX = 3600.0
"""Longest time in which no district is done: a large one takes minutes."""
PROGRESS_SECONDS = 0.5
"""Interval between two reports of progress."""
NOTE = "note"
"""Name of the file of remarks beside the events."""


class CityError(RuntimeError):
    """A city was not learned; ``str()`` names the district, or the worker, and says why."""


def learn_city(
    submit: Callable[..., Future[None]],
    events: Iterable[Event],
    districts: Districts,
    folder: Path,
    settings: Settings | None = None,
    site: str = "city",
    on_progress: Callable[[int], None] = lambda count: None,
    note: Callable[[], bytes] = bytes,
) -> JoinedMap:
    """Learn a city from a recording, each district with one fit.

    submit: submits a call of a function, as `concurrent.futures.Executor.submit`.
    events, folder, note: as `split`; a folder that is there has them from an earlier run.
    on_progress: called with the number of districts that are done, now and then.

    Raises CityError, and ValueError as `merge`.
    """
    if not folder.exists():
        split(events, districts, folder, note)
    for path in folder.glob("*.json"):
        if not path.stat().st_size:
            path.unlink()
    tasks = {submit(fit_district, folder, name, settings or Settings()): name for name in districts}
    pending, since = {*tasks}, time.monotonic()
    try:
        while pending:
            ended, pending = wait(pending, PROGRESS_SECONDS, FIRST_COMPLETED)
            for task in ended:
                since = time.monotonic()
                error = "it was cancelled" if task.cancelled() else task.exception()
                if error is not None:
                    raise CityError(f"district {tasks[task]}: {error}")
            if time.monotonic() - since > QUIET_SECONDS_MAX:
                raise CityError(f"no district was done within {QUIET_SECONDS_MAX:.0f} s")
            on_progress(len(tasks) - len(pending))
    finally:
        for task in tasks:
            task.cancel()
    return merge(
        [load_topology(next(filter(_is_full, _results(folder, name)))) for name in districts],
        districts,
        site,
    )


def split(
    events: Iterable[Event], districts: Districts, folder: Path, note: Callable[[], bytes] = bytes
) -> None:
    """Write the events that each district hears into a file of its own, in a new folder.

    events: in order of time, each once. Those of cameras that no district owns are left out.
    note: returns remarks to keep beside them; called when all events have been read.
    """
    writers = defaultdict(list)
    with (
        TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as new,
        ExitStack() as stack,
    ):
        for name, district in districts.items():
            file = stack.enter_context(files.writing(Path(new, f"{name}.jsonl")))
            for camera in (*district.cameras, *district.hears):
                writers[camera].append(file.write)
        for event in events:
            line = to_json(event) + b"\n"
            for write in writers[event.camera]:
                write(line)
        stack.enter_context(files.writing(Path(new, NOTE))).write(note())
        stack.close()
        Path(new).rename(folder)


def fit_district(folder: Path, district: str, settings: Settings) -> None:
    """Learn a district from its file, unless that is done; a pure function, by way of files.

    Each try has a file of its own, empty until the end, as two may run at once: a cluster repeats
    the tasks of a worker that it does not hear from. Raises CityError after `TRIES_MAX` tries, and
    ValueError without events.
    """
    paths = _results(folder, district)
    if any(map(_is_full, paths)):
        return
    path = next((path for path in paths if not path.exists()), None)
    if path is None:
        raise CityError(f"{TRIES_MAX} processes ended while they learned it, for want of memory?")
    path.touch(exist_ok=False)
    with open(folder / f"{district}.jsonl", "rb") as lines:
        topology = learn_in_order(map(event_from_json, lines), settings, district)
    with files.writing(path) as file:
        file.write(to_json(topology))


def in_process(function: Callable[..., None], *arguments: Any) -> None:
    """Call a function in a process of its own, again if the process is killed."""
    for _ in range(TRIES_MAX + 1):
        with (
            suppress(BrokenProcessPool),
            ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool,
        ):
            return pool.submit(function, *arguments).result()
    raise CityError("its processes end before they begin")


def _results(folder: Path, district: str) -> list[Path]:
    """Return the file of each try of a district, for its topology."""
    return [folder / f"{district}.{number}.json" for number in range(TRIES_MAX)]


def _is_full(path: Path) -> bool:
    """Return True if a try has written its topology."""
    return path.exists() and path.stat().st_size > 0
