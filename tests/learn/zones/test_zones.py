"""Zones of one camera from the sums over its grid."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bench.support.thesis_tables import FIGURE_4_4_ZONES, figure_4_4
from camtopod.learn.zones import (
    clutter as clutter_module,
    marginal_likelihood as likelihood_module,
    separation as valley_module,
)
from camtopod.learn.zones.cells import cell_sums, cells_of, fixed_point
from camtopod.learn.zones.clutter import clutter_rates, dense_cells
from camtopod.learn.zones.marginal_likelihood import log_zone, moments
from camtopod.learn.zones.mixture import ZoneShape
from camtopod.learn.zones.separation import valley_log_ratio
from camtopod.learn.zones.zone_map import ZoneMap, find_zones, match_zones, refresh_zones
from camtopod.topology.grid import POSITION_ONE


def events(
    seed: int, zones: list[tuple[float, float, float, int]], clutter: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 2) in zones (x, y, sd, events) and clutter, and each one's zone (-1)."""
    rng = np.random.default_rng(seed)
    parts = [np.array([x, y]) + sd * rng.standard_normal((n, 2)) for x, y, sd, n in zones]
    labels = [np.full(zone[3], k) for k, zone in enumerate(zones)]
    positions = np.concatenate([*parts, rng.random((clutter, 2))])
    return np.clip(positions, 0, 1), np.concatenate([*labels, np.full(clutter, -1)])


def sums_of(positions: np.ndarray) -> np.ndarray:
    return cell_sums(*fixed_point(positions.T))


def found(positions: np.ndarray, previous: ZoneMap | None = None) -> ZoneMap:
    if previous is None:
        return find_zones(sums_of(positions))
    return find_zones(sums_of(positions), previous.zones, previous.next_number)


def zone_at(zones: ZoneMap, x: float, y: float) -> int:
    """Return the number of the zone there, 0 for none."""
    index = int(zones.cells.flat[cells_of(*fixed_point((x, y)))])
    return zones.zones[index].number if index >= 0 else 0


THREE = [(0.1, 0.5, 0.02, 300), (0.5, 0.95, 0.03, 200), (0.9, 0.4, 0.015, 400)]


def test_three_zones_in_clutter() -> None:
    positions, labels = events(1, THREE, 200)
    zones = found(positions)
    assert len(zones.zones) == 3
    assert [zone.number for zone in zones.zones] == [1, 2, 3]
    assert zones.next_number == 4
    assert sum(zone.weight for zone in zones.zones) == pytest.approx(1)
    own = zones.cells.flat[cells_of(*fixed_point(positions.T))]
    for k, (x, y, _, _) in enumerate(THREE):
        index = zones.cells.flat[cells_of(*fixed_point((x, y)))]
        assert abs(zones.zones[index].x - x) < 0.01
        assert abs(zones.zones[index].y - y) < 0.01
        assert (own[labels == k] == index).mean() > 0.95
    assert (own[labels == -1] == -1).mean() > 0.9


def test_shape_of_a_whole_camera_is_exact() -> None:
    """With fewer than five events everything is one zone."""
    positions, _ = events(2, [(0.4, 0.6, 0.03, 4)])
    (zone,) = found(positions).zones
    fixed = np.rint(positions * POSITION_ONE) / POSITION_ONE
    assert (zone.x, zone.y) == pytest.approx(tuple(fixed.mean(axis=0)), rel=1e-14)
    assert np.array(zone.cov) == pytest.approx(np.cov(fixed.T, bias=True), rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_figure_4_4_has_thirteen_zones(seed: int) -> None:
    for clutter in (0.0, 0.1):
        groups = []
        for place, truth in zip(*figure_4_4(seed, clutter), strict=True):
            zones = found(place)
            own = zones.cells.flat[cells_of(*fixed_point(place.T))]
            groups.append(len(zones.zones))
            main = [np.bincount(own[truth == k] + 1).argmax() for k in range(truth.max() + 1)]
            assert len(set(main)) == truth.max() + 1
            assert 0 not in main
        assert tuple(groups) == FIGURE_4_4_ZONES


def test_a_fire_door_of_one_percent_is_a_zone_and_clutter_is_none() -> None:
    busy = [(0.2, 0.3, 0.03, 4000), (0.8, 0.3, 0.03, 4000)]
    positions, _ = events(3, [*busy, (0.5, 0.9, 0.015, 90)], 1000)
    zones = found(positions)
    assert len(zones.zones) == 3
    assert zone_at(zones, 0.5, 0.9)
    assert len(found(events(3, busy, 1000)[0]).zones) == 2


def test_two_events_that_coincide_are_no_zone_beside_others() -> None:
    """Without any clutter, no event is too unlikely to be clutter."""
    doors = events(5, [(0.1, 0.5, 0.01, 80), (0.6, 0.98, 0.01, 90), (0.99, 0.5, 0.01, 70)])[0]
    stray = np.tile([[0.28, 0.3]], (2, 1))
    zones = found(np.concatenate([doors, stray]))
    assert len(zones.zones) == 3
    assert zone_at(zones, 0.28, 0.3) == 0
    assert len(refresh_zones(sums_of(np.concatenate([doors, doors[:60], stray])), zones).zones) == 3


def test_doors_close_together_with_unequal_traffic() -> None:
    positions, _ = events(
        4, [(0.40, 0.5, 0.012, 900), (0.48, 0.5, 0.012, 60), (0.56, 0.5, 0.012, 400)], 200
    )
    assert len(found(positions).zones) == 3


def test_few_events() -> None:
    none = find_zones(sums_of(np.zeros((0, 2))), next_number=7)
    assert (none.zones, none.next_number) == ((), 7)
    assert (none.cells == -1).all()
    for n in range(1, 5):
        zones = found(np.full((n, 2), 0.5))
        assert len(zones.zones) == 1
        assert zone_at(zones, 0.5, 0.5) == 1


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(0, 1), st.floats(0, 1), st.integers(1, 3000)), min_size=1, max_size=30
    )
)
def test_anything_gives_well_formed_zones(places: list[tuple[float, float, int]]) -> None:
    positions = np.concatenate([np.full((n, 2), (x, y)) for x, y, n in places])
    zones = found(positions)
    assert zones.zones
    assert zones.cells.shape == (30, 24)
    assert zones.cells.dtype == np.int16
    assert -1 <= zones.cells.min() <= zones.cells.max() < len(zones.zones)
    for zone in zones.zones:
        assert 0 <= zone.x <= 1
        assert 0 <= zone.y <= 1
        assert np.linalg.eigvalsh(np.array(zone.cov)).min() > -1e-12


def test_numbers_stay_with_their_places() -> None:
    first = found(events(7, THREE, 200)[0])
    second = found(events(8, THREE[::-1], 100)[0], first)
    for x, y, _, _ in THREE:
        assert zone_at(first, x, y) == zone_at(second, x, y) > 0
    assert second.next_number == first.next_number


def test_a_new_zone_gets_a_new_number_and_a_gone_one_none() -> None:
    first = found(events(9, THREE, 100)[0])
    gone = zone_at(first, 0.5, 0.95)
    moved = found(events(10, [THREE[0], (0.5, 0.1, 0.02, 300), THREE[2]], 100)[0], first)
    assert zone_at(moved, 0.5, 0.1) == 4
    assert gone not in [zone.number for zone in moved.zones]
    later = found(events(11, THREE, 100)[0], moved)
    assert zone_at(later, 0.5, 0.95) == 5  # the caller did not remember it
    remembered = (*moved.zones, *(zone for zone in first.zones if zone.number == gone))
    back = find_zones(sums_of(events(11, THREE, 100)[0]), remembered, moved.next_number)
    assert zone_at(back, 0.5, 0.95) == gone


def test_matching_is_one_to_one_and_global() -> None:
    spot = ((0.0004, 0.0), (0.0, 0.0004))
    old = (ZoneShape(3, 0.50, 0.5, spot, 0.5), ZoneShape(8, 0.56, 0.5, spot, 0.5))
    new = [ZoneShape(0, x, 0.5, spot, 0.5) for x in (0.53, 0.59)]
    zones, next_number = match_zones(old, new, 1)
    assert [(zone.number, zone.x) for zone in zones] == [(3, 0.53), (8, 0.59)]
    assert next_number == 9
    zones, next_number = match_zones(old, [ZoneShape(0, 0.9, 0.9, spot, 1.0)], 20)
    assert [zone.number for zone in zones] == [20]
    assert next_number == 21


@pytest.mark.parametrize(
    ("seed", "zones", "events_of_clutter"), [(1, 0, 300), (2, 3, 150), (3, 1, 4000), (4, 3, 0)]
)
def test_clutter_and_what_stands_out_of_it_equal_their_slow_twins(
    seed: int, zones: int, events_of_clutter: int
) -> None:
    positions, _ = events(seed, THREE[:zones], events_of_clutter)
    count = sums_of(positions)[0]
    rates = clutter_rates(count)
    constants = (
        clutter_module.WIDTH,
        clutter_module.DENSER,
        clutter_module.EVENTS_ALIKE,
        clutter_module.ROUNDS_MAX,
    )
    assert rates == pytest.approx(naive.clutter_rates(count, constants), rel=1e-9)
    chance, contrast = clutter_module.FLOOR_PROBABILITY, clutter_module.CONTRAST_MIN
    slow = naive.dense_cells(count, rates, chance, contrast, clutter_module.FLOOR_WIDTH)
    assert dense_cells(count, rates) == pytest.approx(slow, rel=1e-9)
    assert zones == 0 or slow.any()


@pytest.mark.parametrize("seed", range(4))
def test_valley_equals_its_slow_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.concatenate([rng.normal(0, 1, 40 + 20 * seed), rng.normal(4 + seed, 1.5, 30)])
    fast = valley_log_ratio(np.ones(len(points)), points, np.full(len(points), 1e-9), -3.0, 9.0)
    assert fast == pytest.approx(naive.valley(points, -3.0, 9.0, valley_module._STEPS))
    assert fast > 0


def log_evidence(groups: np.ndarray) -> np.ndarray:
    module = likelihood_module
    result: np.ndarray = naive.log_marginal_likelihood(groups, module._FREEDOM, module._SCALE)
    return result


def test_a_zone_at_once_is_its_evidence_and_its_share() -> None:
    rng = np.random.default_rng(0)
    n = np.concatenate((np.arange(1.0, 60.0), 10.0 ** np.arange(2, 8)))
    x, y = rng.random((2, len(n)))
    xx, yy = rng.random((2, len(n))) * 0.02
    groups = n * np.array(
        (np.ones(len(n)), x, y, x * x + xx, x * y + 0.3 * np.sqrt(xx * yy), y * y + yy)
    )
    for weight in (1.0, 0.3, 0.01):
        weighed = groups * weight
        both = log_evidence(weighed) + naive.log_share(weighed[0], 1.0)
        assert log_zone(weighed[0], moments(weighed)[1]) == pytest.approx(both, rel=1e-12, abs=1e-8)


@pytest.mark.parametrize("seed", [5, 20, 33])
def test_groups_around_one_point_are_no_trouble(seed: int) -> None:
    """Simulated or faulty sources send events at a few exact places; warnings are errors here."""
    chance = np.random.default_rng(seed)
    count = chance.integers(5, 120)
    places = [chance.choice([0.0, 1.0, 0.5], count) for _ in range(2)]
    noise = chance.integers(0, 100)
    positions = np.concatenate((np.array(places).T, chance.uniform(0.0, 1.0, (noise, 2))))
    refresh_zones(sums_of(positions), found(positions[: count // 2]))
    assert len(found(positions).zones) > 0
