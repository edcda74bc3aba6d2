"""Measure the speed of `camtopod learn`, beside baselines run anew for every version.

    python -m bench links [--events 1000000] [--cameras 100] [--rate 0.3] [--rounds 1] [--json FILE]

Ours is `camtopod learn` over a simulated site, in one fit of the last window, as a process of its
own: events a second of processor time. The baselines of `bench quality` are run once over the
newest events (true zones, no clutter; at most the newest ten million candidates, in their favour).
Their time counts once a minute of event time, as each would have to be run again to find changes.
Targets: 20,000 events a second, and 30 times as fast as the fastest baseline.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from bench.baselines.crossings import candidates, crossings
from bench.support import ratios
from bench.support.measure import LINK_METHODS, TAKE_CANDIDATES
from camtopod.cli.commands.export import load
from camtopod.codec import to_json
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.sim.scoring import score
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import Truth

EVENTS_PER_SECOND_MIN = 20_000.0
"""Target, events a second of processor time."""
TIMES_FASTER_MIN = 30.0
"""Target, ratio to the fastest baseline."""
EVENTS_PER_OBJECT = 8.1
"""Events of an object that enters a simulated site, about."""
OURS, TO_REACH = "camtopod learn", "to reach"


def main(argv: Sequence[str]) -> int:
    """Measure, print the table, write the figures; return the exit status."""
    arguments = _parse(argv)
    seconds = arguments.events / (arguments.rate * arguments.cameras)
    objects = arguments.rate * arguments.cameras / EVENTS_PER_OBJECT
    events, truth = simulate(
        SimSettings(
            cameras=arguments.cameras, hours=seconds / 3600.0, seed=5, objects_per_second=objects
        )
    )
    minutes = (events[-1].t - events[0].t) / 60.0
    print(
        f"{len(events)} events of {arguments.cameras} cameras in {minutes:.0f} minutes", flush=True
    )

    # Run ours and the baselines in turns.
    costs: dict[str, list[float]] = {OURS: []}
    with tempfile.TemporaryDirectory() as folder:
        recorded, learned = Path(folder) / "events.jsonl", Path(folder) / "topology.json"
        with recorded.open("wb") as out:
            out.writelines(to_json(event) + b"\n" for event in events)
        for _ in range(arguments.rounds):
            ours, memory = learn(recorded, learned)
            costs[OURS].append(ours)
            for name, once in baselines(events, truth).items():
                costs.setdefault(name, []).append(once * minutes)
        topology = load(str(learned))

    # Report.
    found = score(topology, truth)
    quickest = min((name for name in costs if name != OURS), key=lambda name: sum(costs[name]))
    tables = [
        ratios.compare(
            "a version a minute", "CPU s", costs, quickest, at_most={OURS: 1.0 / TIMES_FASTER_MIN}
        ),
        ratios.compare(
            "events a second of CPU",
            "events/s",
            {
                OURS: [len(events) / cost for cost in costs[OURS]],
                TO_REACH: [EVENTS_PER_SECOND_MIN] * arguments.rounds,
            },
            TO_REACH,
            at_least={OURS: 1.0},
        ),
    ]
    for table in tables:
        print(*ratios.lines(table), sep="\n")
    print(
        f"camtopod learn: {memory:.0f} MB, {topology.version} versions, "
        f"links: precision {found.link_precision:.3f}, recall {found.link_recall:.3f}"
    )
    if arguments.json is not None:
        facts = {
            "events": len(events),
            "minutes": minutes,
            "memory_mb": memory,
            "versions": topology.version,
        }
        ratios.write(arguments.json, "links", tables, **facts)
    return 0


def learn(recorded: Path, learned: Path) -> tuple[float, float]:
    """Return processor seconds and peak megabytes of one `camtopod learn`."""
    command = [sys.executable, "-m", "camtopod", "learn", str(recorded), "--topology", str(learned)]
    process = subprocess.Popen(
        command, stderr=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"}
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"camtopod learn failed with status {os.waitstatus_to_exitcode(status)}")
    process.returncode = 0
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0


def baselines(events: Sequence[Event], truth: Truth) -> dict[str, float]:
    """Return the processor seconds of each baseline over the events our window would hold."""
    settings = Settings()
    held = max(settings.window_events, settings.window_camera_events * len(truth.cameras))
    newest = slice(-held, None)
    cut = Truth(
        truth.schema,
        truth.cameras,
        truth.zones,
        truth.links,
        truth.pairs,
        truth.clock_offsets,
        truth.identity[newest],
        truth.passage[newest],
        truth.zone[newest],
    )
    seen = crossings(events[newest], cut)
    took = {}
    for name, method in LINK_METHODS.items():
        began = time.process_time()
        arguments = (seen, candidates(seen)) if method in TAKE_CANDIDATES else (seen,)
        method(*arguments)
        took[name] = time.process_time() - began
    return took


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench links", description="Measure how fast links are kept up to date."
    )
    parser.add_argument(
        "--events", type=int, default=1_000_000, help="approximate number of events"
    )
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument(
        "--rate", type=float, default=0.3, help="events a second and camera (default 0.3)"
    )
    ratios.add_arguments(parser, rounds=1)
    return parser.parse_args(argv)
