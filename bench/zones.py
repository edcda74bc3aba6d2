"""Measure the share of simulated cameras with the right number of zones, and the cost of zones.

    python -m bench zones [CAMERAS [FIRST_SEED]] [--speed] [--json FILE]

``--speed`` measures the cost only: refreshed zones, as the learner makes them, beside HDBSCAN.

Each camera has two to six zones (spread 0.01 to 0.05 of the image, unequal traffic), 10 to 30 %
clutter, and at least four events in each zone. Compared over the same cameras: plain DaSpec with
the bandwidth rule, k-means with k by silhouette, HDBSCAN. Seeds below 20,000 were used in
development. At the end: how often the zone numbers of a camera change in steady traffic, both held
(as the learner does) and learned anew each time.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from bench.support import ratios
from bench.support.parts import part_parser
from camtopod.arrays import Floats
from camtopod.learn.zones.cells import cell_sums, fixed_point
from camtopod.learn.zones.daspec import bandwidth, data_spectroscopy
from camtopod.learn.zones.zone_map import find_zones, refresh_zones

FIRST_SEED = 1_000_000
SPEED_EVENTS = 10_000
"""Events of a camera whose zones are timed."""
SLOW_EVENTS_MAX = 1000
"""Most events of a camera that the other methods are given."""


class Kind(NamedTuple):
    """A kind of camera.

    apart: least distance of two zones, in mean standard deviations along the line that
        separates them best.
    aspect: longest over shortest spread of a zone.
    line, border: zones in a row; zones along the edges of the view.
    shape: distribution of a zone's events.
    rare: share of the first zone, which is narrow then (0: drawn).
    clutter: even, or half of it in blobs of five times a zone's width, or half of it along the
        straight paths between zones, or all of it along narrow bent ones.
    strip: least and largest thickness of a border that is open along part of an edge.
    least: least number of events in a zone.
    """

    name: str
    apart: float
    aspect: float = 1.6
    line: bool = False
    border: bool = False
    shape: str = "gauss"
    rare: float = 0.0
    clutter: str = "even"
    strip: tuple[float, float] = (0.0, 0.0)
    least: int = 4


KINDS = (
    Kind("round, well apart", 8.0),
    Kind("round", 5.0),
    Kind("long", 5.0, aspect=5.0),
    Kind("along the border", 6.0, aspect=5.0, border=True),
    Kind("doors in a row", 6.0, line=True),
    Kind("boxes", 6.0, aspect=2.0, shape="box"),
    Kind("long boxes", 6.0, aspect=5.0, shape="box"),
    Kind("open borders", 6.0, border=True, shape="box", strip=(0.02, 0.07)),
    Kind("open borders, thick", 6.0, border=True, shape="box", strip=(0.07, 0.14)),
    Kind("heavy tails (t, 3)", 7.0, aspect=3.0, shape="tails"),
    Kind("clutter in blobs", 6.0, clutter="blobs"),
    Kind("clutter along paths", 6.0, clutter="ways"),
    Kind("one narrow zone of 1 %", 6.0, rare=0.01, least=12),
    Kind("clutter along bent paths", 6.0, clutter="bent"),
)
"""The kinds of cameras."""
EVENTS = (60, 300, 1000, 3000, 30_000)
"""Numbers of events in the window."""
STEADY_EVENTS, STEADY_WINDOW = 20_000, 4000
"""Events of the steady traffic, and those in the window."""


SPEED_KINDS = ("round", "along the border", "boxes", "clutter in blobs")
"""Kinds of cameras on which the cost is measured."""


def main(argv: list[str]) -> int:
    """Measure, print the tables and return the exit status."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument(
        "cameras", type=int, nargs="?", default=8, help="cameras of each kind (default 8)"
    )
    parser.add_argument(
        "first", type=int, nargs="?", default=FIRST_SEED, help="seed of the first camera"
    )
    parser.add_argument("--speed", action="store_true", help="measure the cost only")
    ratios.add_arguments(parser, rounds=7)
    arguments = parser.parse_args(argv)
    if not arguments.speed:
        rightness(arguments.cameras, arguments.first)
    table = speed(arguments.first, arguments.rounds)
    print(*ratios.lines(table), sep="\n")
    ratios.write(arguments.json, "zones", [table])
    return 0


def speed(first: int, rounds: int) -> ratios.Table:
    """Compare the processor time of refreshed zones with HDBSCAN's, each with one thread."""
    from sklearn.cluster import HDBSCAN
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    refreshes, fits = [], []
    for kind in KINDS:
        if kind.name in SPEED_KINDS:
            positions, _ = camera(first, kind, SPEED_EVENTS)
            zones = find_zones(cell_sums(*fixed_point(positions[: int(0.95 * SPEED_EVENTS)].T)))
            refreshes.append(partial(refresh_zones, cell_sums(*fixed_point(positions.T)), zones))
            method = HDBSCAN(min_cluster_size=SPEED_EVENTS // 40, copy=True)
            fits.append(partial(method.fit_predict, positions))

    def timed(jobs: Sequence[Callable[[], object]], repeats: int) -> float:
        """Return the CPU milliseconds of a job, with all done ``repeats`` times."""
        start = time.process_time()
        for _ in range(repeats):
            for job in jobs:
                job()
        return 1000 * (time.process_time() - start) / (repeats * len(jobs))

    title = f"zones of a camera, {SPEED_EVENTS:,} events"
    with threadpool_limits(1):
        turns = {"refreshed": partial(timed, refreshes, 20), "HDBSCAN": partial(timed, fits, 1)}
        costs = ratios.take_turns(turns, rounds)
    return ratios.compare(title, "CPU ms", costs, "refreshed")


def rightness(cameras: int, first: int) -> None:
    """Print the shares of cameras with the right number of zones, and how often zones change."""
    print(f"share of {cameras} cameras with the right number of zones:")
    print("camtopod | plain DaSpec | k-means | HDBSCAN")
    print(f"{'':28s}" + "".join(f"{events:>25,d} events" for events in EVENTS))
    seconds, refreshed = 0.0, 0

    # Share of right numbers by kind and number of events.
    for kind in KINDS:
        columns = []
        for events in EVENTS:
            if 0 < kind.rare * events < 1.2 * kind.least:
                columns.append(f"{'':>32s}")
                continue
            right = []
            for seed in range(first, first + cameras):
                positions, zones = camera(seed, kind, events)
                sums = cell_sums(*fixed_point(positions.T))
                start = time.process_time()
                zone_count = len(find_zones(sums).zones)
                seconds, refreshed = seconds + time.process_time() - start, refreshed + 1
                plain = data_spectroscopy(sums[0], bandwidth(sums[0])).groups
                right.append([count == zones for count in (zone_count, plain, *others(positions))])
            shares = " | ".join(f"{share:.2f}" for share in np.mean(right, axis=0))
            columns.append(f"{shares:>32s}")
        print(f"{kind.name:28s}" + "".join(columns), flush=True)
    for kind in KINDS:
        changes = np.mean([flicker(seed, kind) for seed in range(first, first + cameras)], axis=0)
        print(
            f"{kind.name:28s} changes in 1,000 events: held {changes[0]:.3f}, "
            f"anew {changes[1]:.3f}",
            flush=True,
        )
    print(f"camtopod: {1e3 * seconds / refreshed:.1f} ms of processor time a camera\n")


def flicker(seed: int, kind: Kind) -> tuple[float, float]:
    """Return the changes of the zone numbers in 1,000 events of steady traffic: held, and learned
    anew.
    """
    positions, _ = camera(seed, kind, STEADY_EVENTS)
    positions = positions[np.random.default_rng(seed).permutation(len(positions))]
    maps = [find_zones(cell_sums(*fixed_point(positions[:STEADY_WINDOW].T)))] * 2
    changes = [0, 0]
    for at in range(STEADY_WINDOW, STEADY_EVENTS + 1, STEADY_WINDOW // 10):
        sums = cell_sums(*fixed_point(positions[at - STEADY_WINDOW : at].T))
        new = [refresh_zones(sums, maps[0]), find_zones(sums, maps[1].zones, maps[1].next_number)]
        for k in range(2):
            changes[k] += {zone.number for zone in new[k].zones} != {
                zone.number for zone in maps[k].zones
            }
        maps = new
    thousands = (STEADY_EVENTS - STEADY_WINDOW) / 1000
    return changes[0] / thousands, changes[1] / thousands


def others(positions: Floats) -> tuple[int, int]:
    """Return the zones found by k-means and by HDBSCAN.

    k-means has k by silhouette; HDBSCAN has a smallest cluster of 2.5 %, at least 5.
    """
    from sklearn.cluster import HDBSCAN, KMeans
    from sklearn.metrics import silhouette_score

    rng = np.random.default_rng(0)
    draw = positions[rng.choice(len(positions), min(200, len(positions)), replace=False)]
    sample = positions[
        rng.choice(len(positions), min(SLOW_EVENTS_MAX, len(positions)), replace=False)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        labels = {k: KMeans(k, n_init=1, random_state=0).fit_predict(draw) for k in range(2, 8)}
        k_means = max(labels, key=lambda k: float(silhouette_score(draw, labels[k])))
        density = HDBSCAN(min_cluster_size=max(5, len(sample) // 40), copy=True).fit_predict(sample)
    return k_means, int(density.max()) + 1


def camera(seed: int, kind: Kind, events: int) -> tuple[Floats, int]:
    """Return the positions (n, 2) of a camera's events and the number of its zones."""
    rng = np.random.default_rng([seed, events, KINDS.index(kind)])
    clutter = rng.uniform(0.1, 0.3)

    # Draw zones and the zone of each event until every zone has enough.
    while True:
        centres, roots = _zones(rng, kind, int(rng.integers(2, 7)))
        weights = np.maximum(rng.dirichlet(np.full(len(centres), 3.0)), 0.04)
        if kind.rare:
            weights[0] = 0.0
            weights *= (1 - kind.rare / (1 - clutter)) / weights.sum()
            weights[0] = kind.rare / (1 - clutter)
            roots[0] = roots[0] / np.sqrt(np.linalg.det(roots[0])) * rng.uniform(0.01, 0.02)
        labels = rng.choice(len(centres), events, p=weights / weights.sum())
        labels[rng.random(events) < clutter] = -1
        if min(np.bincount(labels + 1, minlength=len(centres) + 1)[1:]) >= kind.least:
            break

    # Draw positions, all within the image.
    positions = _clutter(rng, kind, events, np.array(centres))
    for k, (centre, root) in enumerate(zip(centres, roots, strict=True)):
        rows = np.flatnonzero(labels == k)
        while len(rows):
            spread = rng.standard_normal((len(rows), 2))
            if kind.shape == "box":
                spread = rng.uniform(-np.sqrt(3), np.sqrt(3), (len(rows), 2))
            elif kind.shape == "tails":
                spread *= 0.8 / np.sqrt(rng.chisquare(3, (len(rows), 1)) / 3)
            positions[rows] = centre + spread @ root.T
            rows = rows[((positions[rows] < 0) | (positions[rows] > 1)).any(axis=1)]
    return positions, len(centres)


def _clutter(rng: np.random.Generator, kind: Kind, events: int, centres: Floats) -> Floats:
    """Return positions (n, 2) of clutter."""
    positions = rng.random((events, 2))
    rows = np.flatnonzero(rng.random(events) < 0.5)
    if kind.clutter == "blobs":
        blobs = rng.uniform(0.2, 0.8, (3, 2))[rng.integers(int(rng.integers(1, 4)), size=len(rows))]
        place = blobs + rng.uniform(0.12, 0.25) * rng.standard_normal((len(rows), 2))
        inside = (np.abs(place - 0.5) < 0.5).all(axis=1)
        positions[rows[inside]] = place[inside]
    elif kind.clutter == "ways":
        a = rng.integers(len(centres), size=len(rows))
        b = (a + rng.integers(1, len(centres), size=len(rows))) % len(centres)
        way = centres[a] + rng.random((len(rows), 1)) * (centres[b] - centres[a])
        positions[rows] = np.clip(way + 0.04 * rng.standard_normal(way.shape), 0, 1)
    elif kind.clutter == "bent":
        positions = _on_bent_ways(rng, events, centres)
    return positions


def _on_bent_ways(rng: np.random.Generator, events: int, centres: Floats) -> Floats:
    """Return positions (n, 2) on ways between zones: one arc or two straight pieces a pair."""
    count = len(centres)
    sideways = rng.uniform(-0.5, 0.5, (count, count))
    sharp = rng.random((count, count)) < 0.5
    a = rng.integers(count, size=events)
    b = (a + rng.integers(1, count, size=events)) % count
    low, high = np.minimum(a, b), np.maximum(a, b)  # a way is the same in both directions
    start, across = centres[low], centres[high] - centres[low]
    f = rng.uniform(0.08, 0.92, events)
    height = np.where(sharp[low, high], 1 - np.abs(2 * f - 1), 4 * f * (1 - f))
    aside = (sideways[low, high] * height)[:, None] * across[:, ::-1] * (1, -1)
    way = start + f[:, None] * across + aside + 0.012 * rng.standard_normal((events, 2))
    return np.asarray(np.clip(way, 0, 1), np.float64)


def _zones(rng: np.random.Generator, kind: Kind, zones: int) -> tuple[list[Floats], list[Floats]]:
    """Return the centres of zones and the roots of their covariances, each apart from the others.

    It starts again, maybe with fewer zones, if no place is found for the next one.
    """
    centres: list[Floats] = []
    roots: list[Floats] = []
    angle = rng.uniform(0, np.pi)
    tried = 0
    while len(centres) < zones:
        tried += 1
        if tried > 300:
            zones = max(2, zones - 1) if kind.strip[1] else zones
            centres, roots, tried, angle = [], [], 0, rng.uniform(0, np.pi)
        centre, root = _zone(rng, kind)
        if kind.line:
            root = rng.uniform(0.01, 0.02) * np.eye(2)
            reach = (
                kind.apart / 2 * (root[0, 0] + roots[-1][0, 0]) * rng.uniform(1, 1.8)
                if roots
                else 0.0
            )
            centre = (
                centres[-1] + reach * np.array([np.cos(angle), np.sin(angle)])
                if centres
                else centre
            )
            if (np.abs(centre - 0.5) > 0.47).any():
                centres, roots = [], []
                continue
        if all(
            _apart(centre, root, c, r) >= kind.apart for c, r in zip(centres, roots, strict=True)
        ):
            centres.append(centre)
            roots.append(root)
    return centres, roots


def _zone(rng: np.random.Generator, kind: Kind) -> tuple[Floats, Floats]:
    """Return the centre of a zone and the root of its covariance."""
    short = float(np.exp(rng.uniform(np.log(0.01), np.log(0.05 if kind.aspect < 2 else 0.03))))
    long = min(short * rng.uniform(1, kind.aspect), 0.09)
    centre, turn = rng.uniform(0.07, 0.93, 2), rng.uniform(0, np.pi)
    if kind.border:
        side = int(rng.integers(4))
        turn = np.pi / 2 * (side // 2)
        centre[1 - side // 2] = (0.03, 0.97)[side % 2]
        if kind.strip[1]:
            short, long = rng.uniform(*kind.strip) / np.sqrt(12), rng.uniform(0.05, 0.2)
            centre[1 - side // 2] = (np.sqrt(3) * short, 1 - np.sqrt(3) * short)[side % 2]
            centre[side // 2] = rng.uniform(np.sqrt(3) * long, 1 - np.sqrt(3) * long)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return centre, rotation * (long, short)


def _apart(a: Floats, root_a: Floats, b: Floats, root_b: Floats) -> float:
    """Return the distance in mean standard deviations along the best discriminating line."""
    cov_a, cov_b = root_a @ root_a.T, root_b @ root_b.T
    line = np.linalg.solve(cov_a + cov_b, a - b)
    return float(2 * line @ (a - b) / (np.sqrt(line @ cov_a @ line) + np.sqrt(line @ cov_b @ line)))
