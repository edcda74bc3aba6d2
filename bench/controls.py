"""Count false links where the links are known: unrelated cameras, and streets with lights.

    python -m bench controls [--runs 3] [--first-seed S] [--kinds a,b] [--jobs 2] [--data FOLDER]

A control is a kind of recording whose links are known (`support.control_recordings`). Each seed
makes another recording, which is learned in one fit, as `camtopod learn` does. A link between two
cameras is right if the recording has a way between them with a median within 8 s of the link's, and
false otherwise. The least q-value is over all pairs of zones without a way, published or not. The
target is at most one false link in 30 recordings.

``cages`` is a real recording in ``--data`` (default: CAMTOPOD_REAL_DATA; skipped without), of two
unrelated sites. Each run learns another stretch of it; links within a site are not judged.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from msgspec import Struct

from bench.support.control_recordings import LIGHTS, Control, Street, Traffic, TwoSites
from bench.support.figures import line_of
from bench.support.jobs import map_tasks
from bench.support.parts import data_parser, folders_in, names_from
from bench.support.recordings import CameraPair, load
from camtopod.learn.learner import Learner
from camtopod.records import Event, Topology
from camtopod.topology import weak_links

WAY_SECONDS_APART = 8.0
"""Largest distance of a right link's median from that of its way, seconds."""
RUNS_PER_FALSE_LINK = 30
"""Recordings in which one false link is allowed."""
CAGES = "cages"
"""Name of the real recording; its cameras are named SITE.NUMBER."""
CAGES_PARTS = 10
"""Stretches of the real recording."""


GRID = (
    (8, 2.0, 10.0, 12.0, 2.5),
    (4, 2.0, 120.0, 3.0, 1.0),
    (4, 5.0, 60.0, 12.0, 2.5),
    (4, 10.0, 10.0, 60.0, 40.0),
    (8, 10.0, 30.0, 12.0, 2.5),
    (4, 20.0, 20.0, 12.0, 2.5),
    (4, 40.0, 10.0, 12.0, 2.5),
    (4, 40.0, 40.0, 3.0, 1.0),
    (2, 40.0, 20.0, 12.0, 8.0),
    (2, 80.0, 10.0, 60.0, 40.0),
)
"""Loads: cameras, passages a minute at each, minutes; mean and spread of stays, seconds."""
PACED = (
    ("day", 4.0, 120.0, 0.0),
    ("lights", 6.0, 60.0, 20.0),
    ("lights", 6.0, 60.0, 86.0),
    ("bells", 10.0, 30.0, 30.0),
    ("bells", 6.0, 60.0, 86.0),
    ("bells", 4.0, 120.0, 180.0),
    ("groups", 4.0, 60.0, 0.0),
    ("groups", 20.0, 20.0, 0.0),
    ("batches", 6.0, 60.0, 300.0),
    ("batches", 6.0, 60.0, 900.0),
)
"""Rhythm of four cameras, passages a minute at each, minutes, and the cycle, seconds."""
DOORS = (0, 3)
"""Places where objects come and go in each view: each control with each; 0 without positions."""


def controls() -> dict[str, dict[str, Control]]:
    """Return all controls, by kind and title."""
    grid = [Traffic(*load, doors) for load in GRID for doors in DOORS]
    paced = [
        Traffic(4, per_minute, minutes, rhythm=rhythm, cycle=cycle, doors=doors)
        for rhythm, per_minute, minutes, cycle in PACED
        for doors in DOORS
    ]
    kinds: dict[str, dict[str, Control]] = {}
    for traffic in grid + paced:
        kinds.setdefault(traffic.rhythm, {})[_title(traffic)] = traffic
    kinds["street"] = {f"lights of a street: {light}": Street(light) for light in LIGHTS}
    kinds["sites"] = {"two streets that nothing joins": TwoSites()}
    return kinds


def _title(traffic: Traffic) -> str:
    """Return the title of a control without links: cameras, load, stay, cycle, positions."""
    cycle = f", cycle {traffic.cycle:g} s" if traffic.cycle and traffic.rhythm != "steady" else ""
    doors = f", {traffic.doors} doors" if traffic.doors else ""
    return (
        f"{traffic.rhythm}: {traffic.cameras} x {traffic.per_minute:g}/min, "
        f"{traffic.minutes:g} min, stay {traffic.stay:g} s{cycle}{doors}"
    )


class Outcome(Struct):
    """What was learned of one recording.

    right: ways of the recording that a link shows.
    false: links that are no ways, in words.
    least_q: least q-value of pairs of zones that are no way.
    """

    events: int
    right: int
    false: list[str]
    least_q: float


class Task(Struct, frozen=True):
    """A recording to be made and learned: a control by kind and title, and its seed.

    data: folder of the real recording, for `CAGES`, whose stretch the seed numbers.
    """

    kind: str
    title: str
    seed: int
    data: Path | None = None


def main(argv: Sequence[str]) -> int:
    """Measure, print a row for each control and return the exit status."""
    arguments = _parse(argv)
    controls_by_kind = controls()

    # The recordings, and what is learned of them.
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
    tasks = [
        Task(kind, title, seed)
        for kind in arguments.kinds
        for title in controls_by_kind.get(kind, ())
        for seed in seeds
    ]
    folders = [folder for folder in folders_in(arguments.data) if folder.name == CAGES]
    if CAGES in arguments.kinds:
        for folder in folders:
            tasks += [Task(CAGES, "two cages", part, folder) for part in range(CAGES_PARTS)]
        if not folders:
            print(f"{CAGES}: skipped, no recording found (set --data or CAMTOPOD_REAL_DATA)")
    outcomes = map_tasks(run, tasks, arguments.jobs)

    print("\n".join(_table(tasks, outcomes)))
    print(line_of("recordings", len(outcomes)))
    print(line_of("false links", sum(len(outcome.false) for outcome in outcomes)))
    return 0


def run(task: Task) -> Outcome:
    """Make the recording of a task, learn it and judge its links."""
    if task.data is not None:
        recording = load(task.data)
        events, pairs = _stretch(recording.events, task.seed), _within_sites(recording.cameras)
        return judge(learned(events), pairs, len(events))
    control = controls()[task.kind][task.title]
    events = control.record(task.seed)
    return judge(learned(events), control.ways, len(events))


def learned(events: Sequence[Event]) -> Topology:
    """Return the one version that is learned of a recording."""
    learner = Learner(only_last=True)
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    return learner.topology


def judge(topology: Topology, ways: Mapping[CameraPair, float | None], events: int) -> Outcome:
    """Compare a topology with the ways of its recording.

    ways: by pair of cameras, the median transit time in seconds; None if any is right.
    events: number of events, for the report.
    """
    camera = {zone.id: zone.camera for zone in topology.zones}
    right, false, least_q = set(), [], 1.0
    for is_published, links in ((True, topology.links), (False, weak_links(topology))):
        for link in links:
            pair = camera[link.from_], camera[link.to]
            if pair[0] == pair[1]:
                continue
            way = ways.get(pair, math.inf)
            if way is None or abs(link.transit.q50 - way) < WAY_SECONDS_APART:
                if is_published:
                    right.add(pair)
                continue
            least_q = min(least_q, link.q_value)
            if is_published:
                false.append(
                    f"{link.from_} to {link.to} in {link.transit.q50:.1f} s, {link.relation}, "
                    f"q {link.q_value:.0e}, share {link.probability:.2f}"
                )
    return Outcome(events, len(right), false, least_q)


def _within_sites(cameras: Sequence[str]) -> dict[CameraPair, float | None]:
    """Return the pairs of cameras of one site, which are not judged."""
    site = {camera: camera.partition(".")[0] for camera in cameras}
    return {(a, b): None for a in cameras for b in cameras if site[a] == site[b]}


def _stretch(events: Sequence[Event], part: int) -> list[Event]:
    """Return the events of one of `CAGES_PARTS` stretches, which overlap by a half."""
    length = 2 * len(events) // (CAGES_PARTS + 1)
    return list(events[part * length // 2 : part * length // 2 + length])


def _table(tasks: Sequence[Task], outcomes: Sequence[Outcome]) -> list[str]:
    """Return a row for each control, then all false links, by seed."""
    rows: dict[str, list[Outcome]] = {}
    for task, outcome in zip(tasks, outcomes, strict=True):
        rows.setdefault(task.title, []).append(outcome)
    control_of = {title: control for kind in controls().values() for title, control in kind.items()}
    lines = [
        f"{'':62}{'events':>8}{'runs':>6}{'false':>7}{'in runs':>9}{'least q':>10}  right ways"
    ]
    for title, runs in rows.items():
        line = f"{title:62}{sum(run.events for run in runs) // len(runs):8}{len(runs):6}"
        line += f"{sum(len(run.false) for run in runs):7}{sum(bool(run.false) for run in runs):9}"
        line += f"{min(run.least_q for run in runs):10.0e}"
        if title in control_of and control_of[title].ways:
            right = sum(run.right for run in runs) / len(runs)
            line += f"  {right:.1f} of {len(control_of[title].ways)}"
        lines.append(line)
    false = sum(len(outcome.false) for outcome in outcomes)
    limit = len(outcomes) / RUNS_PER_FALSE_LINK
    lines.append(f"{false} false links in {len(outcomes)} recordings; at most {limit:.1f} allowed")
    for task, outcome in zip(tasks, outcomes, strict=True):
        lines += [f"  {task.title}, seed {task.seed}: {link}" for link in outcome.false]
    return lines


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = data_parser(__name__, __doc__)
    parser.add_argument("--runs", type=int, default=3, help="recordings of each (default 3)")
    parser.add_argument("--first-seed", type=int, default=0, help="(default 0)")
    kinds = [*controls(), CAGES]
    parser.add_argument(
        "--kinds", type=names_from(kinds), default=kinds, help="comma-separated (default: all)"
    )
    return parser.parse_args(argv)
