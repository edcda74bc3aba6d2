"""Measure shards of a large site beside one shard: cost of an event, and events to receive.

    python -m bench shards [--cameras 100] [--shards 4] [--hours 0.5] [--rate 0.1] [--rounds 1]
                           [--json FILE]

One shard learns a simulated site; then each of ``--shards`` shards learns its part of a site that
is as many times as large, in districts of the same size and at the same traffic per camera.
Compared are the processor time per event of a shard's own cameras (target: within 10 %) and the
events it receives for each of its own, in all and from the fourth turn on, when no camera is new.
Cameras are assigned by building (``together``), as in a planned installation, and by the hash of
their names, the default. Each camera is a guest in so many turns that the guests of a shard are a
quarter of its own cameras.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from itertools import zip_longest

import numpy as np
from msgspec import Struct, to_builtins
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from bench.scale import EVENTS_PER_OBJECT
from bench.support import ratios
from camtopod.records import Event
from camtopod.sharding.assignment import Sharding
from camtopod.sharding.shard_learner import ShardLearner
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import Truth

DISTRICTS_PER_SHARD = 4
SAME_WITHIN = 0.1
"""Target: largest increase of the cost of an own event."""
TURN_HOURS = 0.1
"""Length of a turn of guests, hours."""
BY_PLACE = "by place"
"""Name of the assignment by building."""
Site = tuple[list[Event], Truth]
"""Events and ground truth of a site."""


class Work(Struct):
    """Work of one shard."""

    name: str
    own: int
    """Events of its own cameras."""
    heard: int
    """Events it listens to."""
    known_own: int
    """Events of its own cameras from the fourth turn on, when nearly all neighbours are known."""
    known_heard: int
    """Events it listens to from the fourth turn on."""
    known_near: int
    """Events of its own cameras and their true neighbours from the fourth turn on."""
    site: int
    """Events of the whole site."""
    seconds: float
    """Processor time, seconds."""


def main(argv: Sequence[str]) -> int:
    """Measure, print the tables, write the figures; return the exit status."""
    arguments = _parse(argv)
    small = site(arguments.cameras, arguments.hours, arguments.rate)
    large = site(arguments.cameras * arguments.shards, arguments.hours, arguments.rate)
    tables, done = [], list[Work]()
    for dealt in (BY_PLACE, "by the hash of their names"):
        costs: dict[str, list[float]] = {}
        for _ in range(arguments.rounds):
            shards = [(number, arguments.shards) for number in range(arguments.shards)]
            runs = [work("one shard", small, (0, 1), dealt)]
            runs += [work("shard {} of {}".format(*shard), large, shard, dealt) for shard in shards]
            for run in runs:
                costs.setdefault(run.name, []).append(run.seconds / run.own * 1e6)
            done += runs
        wanted = {name: 1.0 + SAME_WITHIN for name in costs if name != "one shard"}
        tables.append(
            ratios.compare(
                f"cost of an own event, cameras assigned {dealt}", "us", costs, "one shard", wanted
            )
        )
        print(*ratios.lines(tables[-1]), sep="\n")
        for run in runs:
            heard = f"received {run.heard / run.own:.2f} times as many"
            heard += (
                f", {run.known_heard / max(run.known_own, 1):.2f} times once neighbours are known"
            )
            heard += (
                f" (its own and its true neighbours: {run.known_near / max(run.known_own, 1):.2f})"
            )
            print(f"    {run.name}: {run.own} own events, {heard}; {run.site} on the whole site")
    if arguments.json is not None:
        ratios.write(arguments.json, "shards", tables, work=to_builtins(done))
    return 0


def site(cameras: int, hours: float, rate: float) -> Site:
    """Simulate a site and return its events and ground truth."""
    objects = rate * cameras / EVENTS_PER_OBJECT
    return simulate(
        SimSettings(cameras=cameras, hours=hours, seed=cameras, objects_per_second=objects)
    )


def work(name: str, site: Site, shard: tuple[int, int], dealt: str) -> Work:
    """Let one shard learn the events it listens to."""
    events, truth = site
    districts = DISTRICTS_PER_SHARD * shard[1]
    places = place_patterns(truth, districts) if dealt == BY_PLACE else ()
    learner = ShardLearner(
        sharding=Sharding(
            districts=districts, together=places, guest_turns=4 * shard[1], turn_hours=TURN_HOURS
        ),
        shard=shard,
    )

    # Count events; true neighbours are those of the site's camera pairs.
    own = heard = known_own = known_heard = known_near = 0
    near = {camera for camera in truth.cameras if learner.owns(camera)}
    near |= {camera for pair in truth.pairs if near & {*pair.cameras} for camera in pair.cameras}
    known = events[0].t + 3 * TURN_HOURS * 3600.0
    began = time.process_time()
    for event in events:
        is_own, is_heard = learner.owns(event.camera), learner.listens(event.camera, event.t)
        own, heard = own + is_own, heard + is_heard
        if event.t >= known:
            known_own, known_heard = known_own + is_own, known_heard + is_heard
            known_near += event.camera in near
        if is_heard:
            learner.receive(event)
    learner.flush()
    return Work(
        name,
        own,
        heard,
        known_own,
        known_heard,
        known_near,
        len(events),
        time.process_time() - began,
    )


def place_patterns(truth: Truth, districts: int) -> tuple[str, ...]:
    """Return patterns that assign cameras joined by paths to one district.

    The cameras are ordered in a line in which neighbours are near, and the line is cut.
    """
    number = {camera: k for k, camera in enumerate(truth.cameras)}
    joined = np.zeros((len(number), len(number)))
    for pair in truth.pairs:
        a, b = (number[camera] for camera in pair.cameras)
        joined[a, b] = joined[b, a] = 1.0
    line = reverse_cuthill_mckee(csr_matrix(joined), symmetric_mode=True)
    blocks = [[truth.cameras[k] for k in block] for block in np.array_split(line, districts)]
    return tuple(camera or "nobody" for turn in zip_longest(*blocks) for camera in turn)


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench shards", description="Measure several shards beside one."
    )
    parser.add_argument(
        "--cameras", type=int, default=100, help="cameras of the one shard's site (default 100)"
    )
    parser.add_argument(
        "--shards", type=int, default=4, help="shards of the larger site (default 4)"
    )
    parser.add_argument(
        "--hours", type=float, default=0.5, help="length of the recordings (default 0.5)"
    )
    parser.add_argument(
        "--rate", type=float, default=0.1, help="events a second and camera (default 0.1)"
    )
    ratios.add_arguments(parser, rounds=1)
    return parser.parse_args(argv)
