"""Learn the demo's site without its bus: are the learned zones and links the true ones?

    python -m bench demo [--seeds 10] [--plans 10] [--minutes 18] [--films FOLDER]

First the demo's own floor plan with the people of each seed, then as many other floor plans, drawn
from a seed (`bench.scenes.drawn_plan`). Each is rendered, seen by the grabber's pipeline, and
learned event by event with the demo's settings, all in this process: about a minute each. FOLDER
keeps the films. `camtopod demo` is the same with processes, a bus and a daemon.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.scenes.drawn_plan import drawn_plan
from bench.support.figures import line_of
from bench.support.measure import harmonic_mean
from bench.support.parts import part_parser
from camtopod.cli.commands.demo import MINUTES, WALKERS_PER_SECOND
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event, Topology, Zone
from camtopod.sim.floor import Plan, Walk, demo_plan, passages, simulate_walks, truth_of
from camtopod.sim.rendering import SUFFIX, render
from camtopod.sim.scoring import Score, match_zones, score
from camtopod.sim.truth import Truth
from camtopod.vision.grabber import Grabber
from camtopod.vision.source import FileOptions

SEEDS, PLANS = 10, 10
START = 1_700_000_000.0
"""Time of the beginning of the recordings, seconds since the epoch."""


def main(argv: list[str]) -> int:
    """Print a line for each site and return the exit status."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="recordings of the demo's plan")
    parser.add_argument("--plans", type=int, default=PLANS, help="other floor plans")
    parser.add_argument("--minutes", type=float, default=MINUTES, help="length of a recording")
    parser.add_argument("--films", type=Path, metavar="FOLDER", help="folder to keep the films in")
    arguments = parser.parse_args(argv)

    # Record, learn and score each site.
    sites = [(f"demo, seed {seed}", demo_plan(), seed) for seed in range(1, arguments.seeds + 1)]
    sites += [(f"plan {seed}", drawn_plan(seed), seed) for seed in range(1, arguments.plans + 1)]
    right = 0
    print(
        f"{'site':16}{'events':>8}{'zones: true':>13}{'learned':>9}{'matched':>9}"
        f"{'links: true':>13}{'learned':>9}{'F1':>7}"
    )
    with tempfile.TemporaryDirectory() as temporary:
        for title, plan, seed in sites:
            films = (arguments.films or Path(temporary)) / title.replace(", seed", "").replace(
                " ", "-"
            )
            seconds, rng = 60.0 * arguments.minutes, np.random.default_rng(seed)
            walks = simulate_walks(plan, seconds, WALKERS_PER_SECOND, rng)
            truth = truth_of(plan, passages(plan, walks))
            events = recorded(plan, walks, seconds, seed, films)
            topology = learned(events)
            result = score(topology, truth)
            good = result.cameras_right == result.cameras
            right += good
            print(_line(title, len(events), result), flush=True)
            if not good:
                print("\n".join(wrong_zones(topology.zones, truth)), flush=True)
    print(f"{right} of {len(sites)} sites with all zones right")
    print(line_of("sites", len(sites)), line_of("sites with all zones right", right), sep="\n")
    return 0


def recorded(plan: Plan, walks: list[Walk], seconds: float, seed: int, films: Path) -> list[Event]:
    """Return what the grabbers see of a recording, in order of time.

    films: folder of the cameras' films; those that are missing are rendered.
    """
    films.mkdir(parents=True, exist_ok=True)
    events: list[Event] = []
    for view in plan.views:
        film = films / f"{view.camera}{SUFFIX}"
        if not film.exists():
            part = film.with_name(f"part-{film.name}")
            render(plan, view, walks, seconds, part, seed)
            part.rename(film)
        grabber = Grabber(
            view.camera, str(film), wall_clock=time.time, file_options=FileOptions(START)
        )
        events += [event for event in grabber.events() if event is not None]
    return sorted(events, key=lambda event: event.t)


def learned(events: list[Event]) -> Topology:
    """Return the topology that the demo's daemon would learn."""
    settings = Settings(lateness_seconds=60.0 * MINUTES, refit_share=0.03)
    learner = Learner(settings, site="demo", epoch="demo")
    for event in events:
        learner.receive(event)
        learner.updates()
    learner.flush()
    assert learner.topology is not None, "no events"
    return learner.topology


def _line(title: str, events: int, result: Score) -> str:
    zones = f"{result.zones_true:>13}{result.zones_learned:>9}{result.zones_matched:>9}"
    f1 = harmonic_mean(result.link_precision, result.link_recall)
    links = f"{result.links_true:>13}{result.links_learned:>9}{f1:>7.2f}"
    return f"{title:16}{events:>8}{zones}{links}"


def wrong_zones(zones: Sequence[Zone], truth: Truth) -> list[str]:
    """Return a line for each zone that is missing, or is learned and not there."""
    matches = match_zones(zones, truth.zones)
    learned_ids = set(matches.values())
    lines = [
        f"    missing: {zone.camera} at ({zone.x:.2f}, {zone.y:.2f})"
        for zone in truth.zones
        if zone.id not in matches
    ]
    return lines + [
        f"    not there: {zone.camera} at ({zone.x:.2f}, {zone.y:.2f}), "
        f"{zone.entries} entries, {zone.exits} exits"
        for zone in zones
        if zone.id not in learned_ids
    ]
