"""How fast `camtopod learn` keeps a topology, beside working out anew at every version what others would.

    python -m bench links [--events 1000000] [--cameras 100] [--rate 0.3] [--json FILE]

Ours is `camtopod learn` over a made-up site, as a process of its own: events a second of processor time. The baselines
of `bench quality` are run once over the newest events (true zones, no clutter; at most the newest ten million pairs of
a departure and an arrival, which is in their favour), and that time is taken for each minute of event time, as each
would have to be run again to say what is new. To reach: 30,000 events a second, and 30 times the quickest of them.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from bench._measure import LINK_METHODS, TAKE_CANDIDATES
from bench.baselines.crossings import candidates, crossings
from bench.scale import EVENTS_PER_OBJECT, learn
from camtopod.cli.predict import read_topology
from camtopod.codec import to_json
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.sim.network import SimSettings, simulate
from camtopod.sim.score import score
from camtopod.sim.truth import Truth

EVENTS_PER_SECOND_MIN = 30_000.0
TIMES_FASTER_MIN = 30.0


def main(argv: Sequence[str]) -> int:
    """Measure, print the table, write the figures; returns the exit status."""
    arguments = _parse(argv)
    seconds = arguments.events / (arguments.rate * arguments.cameras)
    objects = arguments.rate * arguments.cameras / EVENTS_PER_OBJECT
    events, truth = simulate(
        SimSettings(cameras=arguments.cameras, hours=seconds / 3600.0, seed=5, objects_per_second=objects)
    )
    minutes = (events[-1].t - events[0].t) / 60.0
    with tempfile.TemporaryDirectory() as folder:
        recorded, learned = Path(folder) / "events.jsonl", Path(folder) / "topology.json"
        with recorded.open("wb") as out:
            out.writelines(to_json(event) + b"\n" for event in events)
        ours, memory = learn(recorded, learned)
        topology = read_topology(str(learned))
    found = score(topology, truth)
    once = baselines(events, truth)
    quickest = min(once, key=lambda name: once[name])
    rate, faster = len(events) / ours, once[quickest] * minutes / ours
    print(f"{len(events)} events of {arguments.cameras} cameras in {minutes:.0f} minutes")
    print(f"camtopod learn: {ours:.1f} s of processor time, {memory:.0f} MB, {topology.version} versions")
    print(f"  links: precision {found.link_precision:.3f}, recall {found.link_recall:.3f}")
    print(f"  {rate:.0f} events a second{_verdict(rate, EVENTS_PER_SECOND_MIN)}")
    for name, cost in sorted(once.items(), key=lambda item: item[1]):
        print(f"{name}: {cost:.2f} s once, {cost * minutes:.0f} s for a version a minute")
    print(f"  {faster:.1f} times as fast as the quickest, {quickest}{_verdict(faster, TIMES_FASTER_MIN)}")
    if arguments.json is not None:
        content = {"events": len(events), "minutes": minutes, "seconds": ours, "memory_mb": memory, "once": once}
        arguments.json.write_text(json.dumps({"part": "links", **content}, indent=1) + "\n")
    return 0


def baselines(events: Sequence[Event], truth: Truth) -> dict[str, float]:
    """Processor seconds of each over what our window would hold."""
    settings = Settings()
    held = max(settings.window_events, settings.window_camera_events * len(truth.cameras))
    newest = slice(-held, None)
    cut = Truth(
        truth.schema, truth.cameras, truth.zones, truth.links, truth.pairs, truth.clock_offsets,
        truth.identity[newest], truth.passage[newest], truth.zone[newest],
    )  # fmt: skip
    seen = crossings(events[newest], cut)
    took = {}
    for name, method in LINK_METHODS.items():
        began = time.process_time()
        arguments = (seen, candidates(seen)) if method in TAKE_CANDIDATES else (seen,)
        method(*arguments)
        took[name] = time.process_time() - began
    return took


def _verdict(value: float, wanted: float) -> str:
    return f" (to reach {wanted:.0f}: {'yes' if value >= wanted else 'NO'})"


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench links", description="How fast links are kept up to date.")
    parser.add_argument("--events", type=int, default=1_000_000, help="events of the recording, about")
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument("--rate", type=float, default=0.3, help="events a second and camera (default 0.3)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    return parser.parse_args(argv)
