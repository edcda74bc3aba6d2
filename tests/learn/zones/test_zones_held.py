"""Zones are stable: numbers stay in steady or drifting traffic, and change on clear evidence."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.learn.zones.cells import cell_sums, cells_of, fixed_point
from camtopod.learn.zones.zone_map import ZoneMap, find_zones, refresh_zones

DOORS = [(0.05, 0.5), (0.5, 0.95), (0.9, 0.3), (0.4, 0.1)]
WINDOW = 1500


def stream(seed: int, shares: list[float], n: int, clutter: float = 0.25) -> np.ndarray:
    rng = np.random.default_rng(seed)
    door = np.array(DOORS)[rng.choice(len(DOORS), n, p=shares)] + 0.02 * rng.standard_normal((n, 2))
    walked = 0.5 + 0.15 * rng.standard_normal(
        (n, 2)
    )  # clutter is three times as thick in the middle
    even = np.where(rng.random((n, 1)) < 0.75, rng.random((n, 2)), walked)
    return np.clip(np.where(rng.random((n, 1)) < clutter, even, door), 0, 1)


def sums_of(positions: np.ndarray) -> np.ndarray:
    return cell_sums(*fixed_point(positions.T))


def maps(positions: np.ndarray, step: int = 150) -> list[ZoneMap]:
    """Yield the map after every ``step`` events of a sliding window."""
    made = [find_zones(sums_of(positions[:step]))]
    for at in range(2 * step, len(positions) + 1, step):
        made.append(refresh_zones(sums_of(positions[max(0, at - WINDOW) : at]), made[-1]))
    return made


def numbers(zones: ZoneMap) -> tuple[int, ...]:
    return tuple(zone.number for zone in zones.zones)


def number_at(zones: ZoneMap, place: tuple[float, float]) -> int:
    """Return the number of the zone there, 0 for none."""
    index = int(zones.cells.flat[cells_of(*fixed_point(place))])
    return zones.zones[index].number if index >= 0 else 0


@pytest.mark.parametrize("seed", range(2))
def test_steady_traffic_changes_no_number(seed: int) -> None:
    made = maps(stream(seed, [0.4, 0.3, 0.25, 0.05], 9000))
    assert len(made[10].zones) == 4
    assert {numbers(zones) for zones in made[10:]} == {numbers(made[10])}


@pytest.mark.parametrize("seed", range(2))
def test_a_shift_of_traffic_changes_no_number(seed: int) -> None:
    before, after = (
        stream(seed, [0.4, 0.3, 0.2, 0.1], 3000),
        stream(seed + 9, [0.05, 0.35, 0.4, 0.2], 4500),
    )
    made = maps(np.concatenate([before, after]))
    for zones in made[10:]:
        assert [number_at(zones, door) for door in DOORS] == [
            number_at(made[10], door) for door in DOORS
        ]
    assert len({number_at(made[10], door) for door in DOORS} - {0}) == 4
    assert min(zone.weight for zone in made[-1].zones) < 0.1


def test_a_door_that_opens_has_a_number_of_its_own_and_one_that_closes_none() -> None:
    made = maps(
        np.concatenate(
            [stream(0, [0.5, 0.3, 0.2, 0.0], 3000), stream(1, [0.0, 0.5, 0.3, 0.2], 3000)]
        )
    )
    old, new = made[19], made[-1]
    assert len(old.zones) == len(new.zones) == 3
    number = {
        door: zone.number for door in DOORS for zone in new.zones if abs(zone.x - door[0]) < 0.03
    }
    kept = [old.zones[old.cells.flat[cells_of(*fixed_point(door))]].number for door in DOORS[1:3]]
    assert [number[door] for door in DOORS[1:3]] == kept
    assert number[DOORS[3]] not in numbers(old)


def test_early_errors_do_not_stay() -> None:
    """Zones that forty events could not separate are three later."""
    few = stream(5, [0.5, 0.5, 0.0, 0.0], 40)
    made = find_zones(sums_of(few))
    later = stream(6, [0.4, 0.3, 0.3, 0.0], 1500)
    assert len(made.zones) <= 2
    for n in (100, 400, 1500):
        made = refresh_zones(sums_of(np.concatenate([few, later[:n]])), made)
    assert len(made.zones) == 3
