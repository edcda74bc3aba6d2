"""Clock offsets: right clocks that are called wrong, and wrong ones that are found.

    python -m bench clocks [--runs 3] [--regimes a,b] [FOLDER ...]

FOLDER holds a recording with identities (`bench.real`) or clips whose events have a person
(`bench.views`). A recording is learned as it is, and the people of either as visitors at random
times (`bench.views.visits`). Beside them are simulated sites (`support.regimes`). All clocks are
right; then a third of the cameras get an offset of 2 to 40 s either way. An offset is found if it
is estimated within half a second. Where only two clocks can be compared, nobody can tell which of
them is wrong, so the other one may be called wrong instead.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from bench.support.jobs import map_tasks
from bench.support.measure import CLOCK_SECONDS_MAX
from bench.support.recordings import load
from bench.support.regimes import REGIMES
from bench.views import clips_of, learned, visits
from camtopod.records import Event

RUNS = 3
REGIMES_SCALE, DEFAULT_REGIMES = 0.3, "overlapped,dense,faulty"
"""Length of the simulated recordings, and the sites."""
WRONG_SHARE, OFFSET_SECONDS = 1 / 3, (2.0, 40.0)
"""Share of the clocks that are put wrong, and the range of their offsets."""

Task = tuple[str, int, bool]
"""Folder or regime, run, whether the recording is taken as it is."""


def main(argv: list[str]) -> int:
    """Print one row a site and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m bench clocks", description=(__doc__ or "").partition("\n\n")[0]
    )
    parser.add_argument("folders", nargs="*", metavar="FOLDER")
    parser.add_argument("--runs", type=int, default=RUNS, help="(default: %(default)s)")
    parser.add_argument("--regimes", default=DEFAULT_REGIMES, help="(default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    given = parser.parse_args(argv)
    names = [*given.folders, *filter(None, given.regimes.split(","))]
    tasks: list[Task] = [(name, run, False) for name in names for run in range(given.runs)]
    tasks += [(name, 0, True) for name in given.folders if (Path(name) / "identities.csv").exists()]
    rows: dict[str, list[int]] = defaultdict(lambda: [0] * 6)
    for (name, _, as_is), row in zip(tasks, map_tasks(measure, tasks, given.jobs), strict=True):
        for title in (f"{Path(name).name}{', as it is' if as_is else ''}", "all"):
            rows[title] = [a + b for a, b in zip(rows[title], row, strict=True)]
    rows["all"] = rows.pop("all")
    print(f"{'':30}{'right':>9}{'wrong':>9}{'put wrong':>12}{'found':>9}{'right':>12}{'wrong':>9}")
    for title, (right, called, put, found, beside, moved) in rows.items():
        print(f"{title:30}{right:>9}{called:>9}{put:>12}{found:>9}{beside:>12}{moved:>9}")
    return 0


def measure(task: Task) -> list[int]:
    """Return numbers of clocks: right ones, of them called wrong; then with a third of the clocks
    wrong those, of them found, and the right ones beside them, of them called wrong.
    """
    name, run, as_is = task
    rng = np.random.default_rng(run)
    if name in REGIMES:
        events = REGIMES[name].make(run, REGIMES_SCALE)[0]
    elif as_is:
        events = load(Path(name)).events
    else:
        events = visits(_people(Path(name)), [defaultdict(list)], rng).true
    cameras = sorted({event.camera for event in events})

    # As it is.
    none = dict.fromkeys(cameras, 0.0)
    claimed = _offsets(events, none)
    result = [len(cameras), sum(offset != 0.0 for offset in claimed.values())]

    # With wrong clocks.
    wrong = rng.permutation(cameras)[: max(round(WRONG_SHARE * len(cameras)), 1)].tolist()
    put = none | {
        camera: float(rng.choice((-1, 1)) * rng.uniform(*OFFSET_SECONDS)) for camera in wrong
    }
    claimed = _offsets(events, put)
    found = sum(abs(claimed[camera] - put[camera]) <= CLOCK_SECONDS_MAX for camera in wrong)
    moved = sum(claimed[camera] != 0.0 for camera in none if put[camera] == 0.0)
    return [*result, len(wrong), found, len(cameras) - len(wrong), moved]


def _offsets(events: Sequence[Event], put: dict[str, float]) -> dict[str, float]:
    """Return the estimated clock offset of each camera, with known ones added to the times."""
    late = [replace(event, t=event.t + put[event.camera]) for event in events]
    topology = learned(sorted(late, key=lambda event: event.t))
    return put | {camera.id: camera.clock_offset for camera in topology.cameras}


def _people(folder: Path) -> dict[str, list[Event]]:
    """Return the events of each person by time, the first at 0 s."""
    events: dict[str, list[Event]] = defaultdict(list)
    for who, event in _events(folder):
        events[who].append(event)
    return {
        who: [replace(event, t=event.t - some[0].t) for event in some]
        for who, some in events.items()
    }


def _events(folder: Path) -> Iterator[tuple[str, Event]]:
    """Yield who it is and the event, by time."""
    if (folder / "identities.csv").exists():
        recording = load(folder)
        who = {
            passage.track: str(number)
            for number, some in enumerate(recording.by_identity)
            for passage in some
        }
        yield from (
            (who[str(event.track)], event) for event in recording.events if str(event.track) in who
        )
    else:
        some = [event for clip in clips_of(folder, None) for event in clip.truth]
        yield from ((str(event.track), event) for event in sorted(some, key=lambda one: one.t))
