"""Zones of views where tracks are lost and found on the ways between doors."""

from __future__ import annotations

from itertools import combinations

import naive
import numpy as np
import pytest

from camtopod.learn.zones import ways as ways_module
from camtopod.learn.zones.cells import CELLS, Cells, cell_sums, fixed_point
from camtopod.learn.zones.marginal_likelihood import covariance, moments
from camtopod.learn.zones.ways import WAY_CONTRAST, way_contrast
from camtopod.learn.zones.zone_map import find_zones
from camtopod.topology.grid import POSITION_ONE

BORDER = [(0.04, 0.3), (0.5, 0.96), (0.96, 0.35), (0.35, 0.04)]
SHOP = (0.6, 0.5)


def view(
    seed: int, doors: list[tuple[float, float]], shares: list[float], bend: float, on_ways: float
) -> np.ndarray:
    """Return 3,000 positions: at doors, and a share of them on the bent ways between these.

    shares: share of each door in the traffic.
    """
    rng = np.random.default_rng(seed)
    places = np.array(doors)
    positions = places[rng.choice(len(doors), 3000, p=shares)] + rng.normal(0, 0.02, (3000, 2))
    pairs = list(combinations(range(len(doors)), 2))
    traffic = np.array([shares[a] * shares[b] for a, b in pairs])
    bends = rng.uniform(-bend, bend, len(pairs))
    for i in np.flatnonzero(rng.random(3000) < on_ways):
        way = rng.choice(len(pairs), p=traffic / traffic.sum())
        a, b = places[list(pairs[way])]
        middle = (a + b) / 2 + bends[way] * (b - a)[::-1] * (1, -1)
        f = rng.uniform(0.08, 0.92)
        positions[i] = (1 - f) ** 2 * a + 2 * f * (1 - f) * middle + f * f * b
        positions[i] += rng.normal(0, 0.012, 2)
    return np.clip(positions, 0, 1)


def sums_of(positions: np.ndarray) -> np.ndarray:
    return cell_sums(*fixed_point(positions.T))


@pytest.mark.parametrize("bend", [0.0, 0.4])
@pytest.mark.parametrize(
    ("doors", "shares"),
    [
        (BORDER, [0.25] * 4),
        ([*BORDER, SHOP], [0.2] * 5),
        ([*BORDER, SHOP], [0.25, 0.25, 0.22, 0.25, 0.03]),
    ],
)
def test_ways_are_no_zones_and_doors_are(
    doors: list[tuple[float, float]], shares: list[float], bend: float
) -> None:
    busy = [place for place, share in zip(doors, shares, strict=True) if share > 0.1]
    found = false = 0
    for seed in range(6):
        zones = find_zones(sums_of(view(seed, doors, shares, bend, 0.25))).zones
        centres = np.array([(zone.x, zone.y) for zone in zones])
        away = np.hypot(*(centres[:, None] - np.array(doors)).transpose(2, 0, 1))
        assert (away.min(axis=0)[: len(busy)] < 0.03).all()
        found += int((away.min(axis=0) < 0.03).sum())
        false += int((away.min(axis=1) > 0.06).sum())
    assert found >= 6 * len(doors) - 3  # without `ways`, a rare door is lost more often
    assert false <= 3  # without `ways`, there are 12 to 35


def cells_of_view(positions: np.ndarray) -> Cells:
    flat = sums_of(positions).reshape(6, CELLS)
    occupied = np.flatnonzero(flat[0])
    unit = np.array([1.0, *[POSITION_ONE] * 2, *[POSITION_ONE**2] * 3])[:, None]
    return Cells.of(flat[:, occupied] / unit, occupied)


def near(cells: Cells, x: float, y: float) -> np.ndarray:
    """Return the sums of the cells around a place."""
    inside = np.hypot(cells.average[1] - x, cells.average[2] - y) < 0.06
    sums: np.ndarray = cells.sums[:, inside].sum(axis=1)
    return sums


def test_a_crossing_of_ways_and_a_way_have_no_contrast() -> None:
    corners = [(0.1, 0.1), (0.9, 0.9), (0.1, 0.9), (0.9, 0.1)]
    cells = cells_of_view(view(3, corners, [0.25] * 4, 0.0, 0.4))
    rates = np.full((30, 24), 0.5)
    for place in corners:
        assert way_contrast(cells, near(cells, *place), rates) > 3 * WAY_CONTRAST
    for place in ((0.5, 0.5), (0.3, 0.3), (0.5, 0.1)):
        assert way_contrast(cells, near(cells, *place), rates) < WAY_CONTRAST


def test_two_doors_that_are_still_one_group_are_kept_in_a_row() -> None:
    rng = np.random.default_rng(1)
    row = np.array([(0.48, 0.327), (0.361, 0.443), (0.28, 0.521), (0.153, 0.643)])
    positions = row[rng.integers(4, size=3000)] + rng.normal(0, 0.016, (3000, 2))
    even = rng.random((600, 2))
    assert len(find_zones(sums_of(np.concatenate((positions, even)))).zones) == 4


def test_a_row_along_the_border_is_no_way() -> None:
    rng = np.random.default_rng(4)
    ends = np.array([(0.1, 0.03), (0.9, 0.03)])
    doors = ends[rng.integers(2, size=1500)] + rng.normal(0, 0.02, (1500, 2))
    row = rng.uniform((0.15, 0.0), (0.85, 0.06), (600, 2))
    positions = np.clip(np.concatenate((doors, row)), 0, 1)
    cells = cells_of_view(positions)
    inside = cells_of_view(positions + np.array((0, 0.5)))
    rates = np.full((30, 24), 0.1)
    assert way_contrast(cells, near(cells, 0.5, 0.03), rates) == np.inf
    assert way_contrast(inside, near(inside, 0.5, 0.53), rates) < WAY_CONTRAST


@pytest.mark.parametrize("seed", range(2))
def test_contrast_equals_its_slow_twin(seed: int) -> None:
    cells = cells_of_view(view(seed, BORDER, [0.25] * 4, 0.3, 0.3))
    rates = np.random.default_rng(seed).uniform(0.1, 2, (30, 24))
    constants = (
        ways_module.WAY_NATS,
        ways_module.FEW_SHARE,
        ways_module.LEAST_WAY,
        ways_module._ROUNDER,
        ways_module._LONG,
        ways_module._BEND,
        ways_module._KERNEL,
        ways_module.DENSER,
        ways_module._DIRECTIONS,
        ways_module._BACK,
        ways_module._REACH,
    )
    for place in (BORDER[seed], (0.5, 0.5), (0.3, 0.4), (0.5, 0.25)):
        group = near(cells, *place)
        mean, scatter = moments(group)
        cov = covariance(group[0], scatter) + ways_module.CELL_SPREAD[:, 0]
        slow = naive.way_contrast(cells.sums, group[0], mean, cov, rates, constants)
        assert way_contrast(cells, group, rates) == pytest.approx(slow, rel=1e-6)
