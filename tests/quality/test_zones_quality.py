"""Zones of simulated views: right for every kind of view, and only with the method as it is.

Each kind of `bench.zones` has six cameras for each number of events. `test_zones_are_right` asks
for a share of cameras with the right number of zones. The canaries do the same with a part of the
method replaced by something worse, and fail if it would not be noticed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import label
from sklearn.cluster import HDBSCAN

from bench.zones import KINDS, Kind, camera
from camtopod.learn.zones import partition as partition_module
from camtopod.learn.zones.cells import cell_sums, fixed_point
from camtopod.learn.zones.clutter import Labels
from camtopod.learn.zones.daspec import bandwidth, data_spectroscopy
from camtopod.learn.zones.zone_map import find_zones

EVENTS = (1000, 3000, 30_000)
"""Numbers of events of a view."""
FIRST_SEED = 7000
CAMERAS = 6
RIGHT_MIN = 0.9
"""Least share of right cameras of a kind."""
HARD = {
    "open borders, thick": 0.75,
    "clutter along paths": 0.85,
    "clutter along bent paths": 0.75,
}
"""Least share for the kinds that are not always told from clutter."""
Method = Callable[..., object]
HERE = partition_module
GROUPING, MOVES = "daspec_groups", partition_module._Partition


@cache
def views(kind: Kind) -> list[tuple[np.ndarray, int]]:
    """Return the sums over the grid, and the number of zones, of each camera of a kind."""
    cameras = [
        camera(seed, kind, events)
        for events in EVENTS
        for seed in range(FIRST_SEED, FIRST_SEED + CAMERAS)
        if not kind.rare or kind.rare * events > 1.2 * kind.least
    ]
    return [(cell_sums(*fixed_point(positions.T)), zones) for positions, zones in cameras]


def right(kind: Kind) -> float:
    """Return the share of cameras of a kind with the right number of zones."""
    return float(np.mean([len(find_zones(sums).zones) == zones for sums, zones in views(kind)]))


def least(kind: Kind) -> float:
    """Return the least share of right cameras of a kind."""
    return HARD.get(kind.name, RIGHT_MIN)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_zones_are_right(kind: Kind) -> None:
    assert right(kind) >= least(kind)


def touching(dense: np.ndarray) -> Labels:
    """Group cells that touch each other."""
    return np.asarray(label(dense > 0, np.ones((3, 3)))[0].ravel() - 1, np.intp)


def one_group(dense: np.ndarray) -> Labels:
    """Put all cells into one group."""
    return np.where(dense.ravel() > 0, 0, -1).astype(np.intp)


def by_density(dense: np.ndarray) -> Labels:
    """Group the events of the cells by HDBSCAN."""
    cells = np.flatnonzero(dense)
    weight = dense.ravel()[cells]
    events = np.repeat(np.arange(len(cells)), np.ceil(1000 * weight / weight.sum()).astype(int))
    places = np.stack(np.divmod(cells, dense.shape[1]), axis=1)[events]
    places = places + np.random.default_rng(0).uniform(-0.5, 0.5, places.shape)
    method = HDBSCAN(min_cluster_size=max(5, len(places) // 40), copy=True)
    labels = np.full(dense.size, -1, np.intp)
    labels[cells[events]] = method.fit_predict(places)
    return labels


def plain_daspec(dense: np.ndarray) -> Labels:
    """Group the cells by DaSpec with the whole bandwidth, once."""
    result = data_spectroscopy(dense, bandwidth(dense))
    labels = np.full(dense.size, -1, np.intp)
    labels[result.cells] = result.labels
    return labels


CANARIES: dict[str, tuple[str, object, str, Method]] = {
    "cells that touch": ("clutter along bent paths", HERE, GROUPING, touching),
    "one group": ("along the border", HERE, GROUPING, one_group),
    "HDBSCAN": ("boxes", HERE, GROUPING, by_density),
    "plain DaSpec": ("long boxes", HERE, GROUPING, plain_daspec),
    "clutter stays": (
        "doors in a row",
        HERE,
        "dense_cells",
        lambda count, rate: count.astype(float),
    ),
    "no ways": ("clutter along bent paths", HERE, "way_contrast", lambda *_: np.inf),
    "no merging": ("open borders", MOVES, "_merge", lambda self: None),
    "no splitting": ("boxes", MOVES, "_split", lambda self: False),
    "no dropping": ("round, well apart", MOVES, "_drop", lambda self: None),
}
"""Parts of the method: the kind of view that needs it, and what replaces it."""


@pytest.mark.parametrize("canary", CANARIES)
def test_a_worse_method_is_noticed(canary: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, owner, part, worse = CANARIES[canary]
    kind = next(kind for kind in KINDS if kind.name == name)
    monkeypatch.setattr(owner, part, worse)
    assert right(kind) < least(kind)
