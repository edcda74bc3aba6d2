"""Measure how often right clocks are called wrong, and how often wrong ones are found.

    python -m bench clocks [--runs 3] [--regimes a,b] [FOLDER ...]

A FOLDER holds a recording with identities (`bench real`), or clips whose events have a person
(`bench views`). A recording with identities is learned as it is. Besides, the people of each FOLDER
are learned as visitors at random times (`bench.views.visits`), and sites are simulated
(`support.regimes`). First all clocks are right; then a third of the cameras get an offset of 2 to
40 s in either direction. An offset is found if its estimate is within half a second. Where only two
clocks can be compared, the data does not tell which of them is wrong, so that the right one may be
called wrong.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from bench.support.jobs import map_tasks
from bench.support.measure import CLOCK_SECONDS_MAX
from bench.support.parts import part_parser
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
    parser = part_parser(__name__, __doc__)
    parser.add_argument("folders", nargs="*", metavar="FOLDER")
    parser.add_argument("--runs", type=int, default=RUNS, help="(default: %(default)s)")
    parser.add_argument("--regimes", default=DEFAULT_REGIMES, help="(default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    arguments = parser.parse_args(argv)
    names = [*arguments.folders, *filter(None, arguments.regimes.split(","))]
    tasks: list[Task] = [(name, run, False) for name in names for run in range(arguments.runs)]
    tasks += [
        (name, 0, True) for name in arguments.folders if (Path(name) / "identities.csv").exists()
    ]
    rows: dict[str, list[int]] = defaultdict(lambda: [0] * 6)
    for (name, _, as_is), row in zip(tasks, map_tasks(measure, tasks, arguments.jobs), strict=True):
        for title in (f"{Path(name).name}{', as it is' if as_is else ''}", "all"):
            rows[title] = [a + b for a, b in zip(rows[title], row, strict=True)]
    rows["all"] = rows.pop("all")
    print(f"{'':30}{'right':>9}{'wrong':>9}{'put wrong':>12}{'found':>9}{'right':>12}{'wrong':>9}")
    for title, counts in rows.items():
        print("{:30}{:>9}{:>9}{:>12}{:>9}{:>12}{:>9}".format(title, *counts))
    return 0


def measure(task: Task) -> list[int]:
    """Return six numbers of clocks.

    With all clocks right: all, and those called wrong. With a third of them wrong: the wrong ones,
    those of them that are found, the right ones, and those of them that are called wrong.
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
    no_offsets = dict.fromkeys(cameras, 0.0)
    estimates = _offsets(events, no_offsets)
    result = [len(cameras), sum(offset != 0.0 for offset in estimates.values())]

    # With wrong clocks.
    wrong = rng.permutation(cameras)[: max(round(WRONG_SHARE * len(cameras)), 1)].tolist()
    offsets = no_offsets | {
        camera: float(rng.choice((-1, 1)) * rng.uniform(*OFFSET_SECONDS)) for camera in wrong
    }
    estimates = _offsets(events, offsets)
    hits = sum(abs(estimates[camera] - offsets[camera]) <= CLOCK_SECONDS_MAX for camera in wrong)
    false_alarms = sum(estimates[camera] != 0.0 for camera in no_offsets if offsets[camera] == 0.0)
    return [*result, len(wrong), hits, len(cameras) - len(wrong), false_alarms]


def _offsets(events: Sequence[Event], offsets: dict[str, float]) -> dict[str, float]:
    """Return the estimated clock offset of each camera, with known ones added to the times."""
    late = [replace(event, t=event.t + offsets[event.camera]) for event in events]
    topology = learned(sorted(late, key=lambda event: event.t))
    return offsets | {camera.id: camera.clock_offset for camera in topology.cameras}


def _people(folder: Path) -> dict[str, list[Event]]:
    """Return the events of each person by time, the first at 0 s."""
    events: dict[str, list[Event]] = defaultdict(list)
    for person, event in _events(folder):
        events[person].append(event)
    return {
        person: [replace(event, t=event.t - trajectory[0].t) for event in trajectory]
        for person, trajectory in events.items()
    }


def _events(folder: Path) -> Iterator[tuple[str, Event]]:
    """Yield the person and the event, by time."""
    if (folder / "identities.csv").exists():
        recording = load(folder)
        person_of = {
            passage.track: str(number)
            for number, passages in enumerate(recording.by_identity)
            for passage in passages
        }
        for event in recording.events:
            if str(event.track) in person_of:
                yield person_of[str(event.track)], event
    else:
        events = [event for clip in clips_of(folder, None) for event in clip.truth]
        yield from ((str(e.track), e) for e in sorted(events, key=lambda event: event.t))
