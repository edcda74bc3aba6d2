"""CPU time of a camera's zones: with growing windows, and against methods that cluster points.

Every method has one thread. A turn computes the zones of every camera, `REPEATS` times over where
that takes milliseconds only.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bench.support import ratios
from camtopod.arrays import Floats
from camtopod.learn.zones.clutter import (
    FLOOR_PROBABILITY,
    clutter_rates,
    daspec_groups,
    dense_cells,
)
from camtopod.learn.zones.daspec import BANDWIDTH_MIN, bandwidth, data_spectroscopy
from camtopod.learn.zones.zone_map import CellSums, ZoneMap, cell_sums, find_zones, refresh_zones
from camtopod.topology.grid import GRID_COLUMNS, GRID_ROWS

Camera = Callable[[int], tuple[Floats, int]]
"""Function from a number of events to their positions (n, 2) and the number of zones."""

REFRESHED, ANEW = "zones refreshed", "zones from nothing"
"""Titles: zones updated from the earlier ones, as the learner does, and found without them."""
GROUPS, EVERYWHERE = "DaSpec over the dense cells", "DaSpec over all occupied cells"
"""Titles: DaSpec over the dense cells, as the learner does, and over all cells with clutter.

The latter has fewer cells with fewer events.
"""
EVENTS = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
"""Numbers of events in the window."""
FLAT_MAX = 1.5
"""Target: largest ratio of the time to that of the smallest window."""
HDBSCAN_POINTS, HDBSCAN_RATIO_MIN = 10_000, 100.0
"""Points that HDBSCAN clusters, and the target of its ratio to ours."""
SPECTRAL_POINTS, SPECTRAL_RATIO_MIN = 3_000, 500.0
"""Points that spectral clustering clusters, and the target of its ratio to ours."""
REPEATS = 20
"""Repetitions of a job in a turn."""
BATCH = 1_000_000
"""Events whose cells are summed at once."""
NEW_SHARE = 0.05
"""Share of the events in the window that have come since the zones were last learned."""


def tables(
    cameras: Sequence[Camera], rounds: int, events: Sequence[int] = EVENTS
) -> list[ratios.Table]:
    """Return every comparison. Raises ModuleNotFoundError without scikit-learn."""
    import sklearn.cluster  # noqa: F401  # first: the limit applies to loaded libraries only
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    with threadpool_limits(1):
        return [*flatness(cameras, rounds, events), *against_points(cameras, rounds)]


def flatness(cameras: Sequence[Camera], rounds: int, events: Sequence[int]) -> list[ratios.Table]:
    """Compare the same cameras with growing windows."""
    windows: dict[int, list[tuple[CellSums, ZoneMap]]] = {n: [] for n in events}
    for camera in cameras:
        positions, _ = camera(max(events))
        for n in events:
            windows[n].append(window(positions[:n]))
    dense = {n: [_dense(sums) for sums, _ in those] for n, those in windows.items()}
    counts = {n: [sums.count for sums, _ in those] for n, those in windows.items()}
    jobs: dict[str, dict[int, list[Callable[[], object]]]] = {
        REFRESHED: {
            n: [partial(refresh_zones, *one) for one in those] for n, those in windows.items()
        },
        ANEW: {n: [partial(find_zones, sums) for sums, _ in those] for n, those in windows.items()},
        GROUPS: {n: [partial(daspec_groups, one) for one in dense[n]] for n in events},
        EVERYWHERE: {n: [partial(_plain, one) for one in counts[n]] for n in events},
    }
    return [
        ratios.compare(
            title,
            "CPU ms a camera",
            ratios.take_turns(
                {_named(n): _timed(own[n], 1 if title == EVERYWHERE else None) for n in events},
                rounds,
            ),
            _named(events[0]),
            {_named(n): FLAT_MAX for n in events[1:]},
        )
        for title, own in jobs.items()
    ]


def against_points(cameras: Sequence[Camera], rounds: int) -> list[ratios.Table]:
    """Compare ours, with as many events in the window, with methods that cluster points."""
    from sklearn.cluster import HDBSCAN, SpectralClustering

    result = []
    for name, n, wanted in (
        ("HDBSCAN", HDBSCAN_POINTS, HDBSCAN_RATIO_MIN),
        ("SpectralClustering", SPECTRAL_POINTS, SPECTRAL_RATIO_MIN),
    ):
        made = [camera(n) for camera in cameras]
        windows = [window(positions) for positions, _ in made]
        theirs = []
        for (positions, zones), (sums, _) in zip(made, windows, strict=True):
            method = HDBSCAN(min_cluster_size=n // 40, copy=True)
            if name == "SpectralClustering":
                method = SpectralClustering(
                    zones, gamma=0.5 / _bandwidth(sums) ** 2, random_state=0
                )
            theirs.append(partial(method.fit_predict, positions))
        costs = ratios.take_turns(
            {
                REFRESHED: _timed([partial(refresh_zones, *one) for one in windows]),
                GROUPS: _timed([partial(daspec_groups, _dense(sums)) for sums, _ in windows]),
                name: _timed(theirs, 1),
            },
            rounds,
        )
        for ours in (REFRESHED, GROUPS):
            both = {one: costs[one] for one in (ours, name)}
            title = f"{name} of {n:,} points"
            result.append(
                ratios.compare(title, "CPU ms a camera", both, ours, at_least={name: wanted})
            )
    return result


def window(positions: Floats) -> tuple[CellSums, ZoneMap]:
    """Return the sums of all events, and the zones before the newest ones came."""
    old = int((1 - NEW_SHARE) * len(positions))
    return summed(positions), find_zones(summed(positions[:old]))


def summed(positions: Floats) -> CellSums:
    """Return `cell_sums` of any number of positions."""
    parts = [cell_sums(*positions[k : k + BATCH].T) for k in range(0, len(positions), BATCH)]
    return CellSums(*np.sum(np.array(parts), axis=0))


def _dense(sums: CellSums) -> Floats:
    """Return the counts of the dense cells."""
    return dense_cells(sums.count, clutter_rates(sums.count), FLOOR_PROBABILITY)


def _bandwidth(sums: CellSums) -> float:
    """Return the bandwidth of DaSpec's first groups, fraction of the image."""
    return 2 * max(bandwidth(_dense(sums)) / 2, BANDWIDTH_MIN) / (GRID_ROWS + GRID_COLUMNS)


def _plain(count: NDArray[np.int64]) -> None:
    """Group all occupied cells by plain DaSpec."""
    data_spectroscopy(count, bandwidth(count))


def _named(events: int) -> str:
    return f"{events:,} events"


def _timed(jobs: Sequence[Callable[[], object]], repeats: int | None = None) -> Callable[[], float]:
    """Return a turn: CPU milliseconds a job, with all jobs done ``repeats`` (`REPEATS`) times."""
    times = repeats or REPEATS

    def turn() -> float:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # spectral clustering where the graph has several parts
            began = time.process_time()
            for _ in range(times):
                for job in jobs:
                    job()
            return 1000 * (time.process_time() - began) / (times * len(jobs))

    return turn
