"""Floor plans like the demo's, drawn from a seed: five cameras, paths and streets."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from camtopod.arrays import Floats
from camtopod.sim.floor import Area, Floor, Plan, View, passages, simulate_walks, truth_of

CAMERAS = 5
COLUMNS, ROWS = 3, 2
"""Cells of the grid; each has a camera or nothing."""
CELL_METRES = (19.0, 17.0)
"""Width and depth of a cell."""
SHIFT_METRES = 2.5
"""Largest distance of a camera's place from the middle of its cell, in each direction."""
OVERLAP_METRES, OVERLAP_SHARE = 5.8, 0.6
"""Distance of two cameras whose views overlap, and share of the plans that have such a pair."""
PATH_SHARE, STREET_SHARE = 0.8, 0.6
"""Share of the neighbouring cameras with a path between them, and of the outer sides with a street.
"""
STREET_METRES = 13.0
"""Length of a street."""
STREETS_MIN = 3
"""Least number of streets."""
APART_MIN, SPREAD_MAX, PASSAGES_MIN = 0.25, 0.09, 12
"""A drawn plan is taken if all zones of a view are so far apart, with no larger standard deviation
(fractions of the picture), and are passed so often in `TRIAL_SECONDS`.
"""
TRIAL_SECONDS, TRIAL_RATE = 600.0, 0.1
"""Length of the trial, and people a second in it."""
TRIES_MAX = 1000
"""Most plans that are drawn."""
_SIDES = {"west": (-1, 0), "east": (1, 0), "south": (0, -1), "north": (0, 1)}


def drawn_plan(seed: int) -> Plan:
    """Return a plan; ValueError if none is found."""
    rng = np.random.default_rng((seed, 29))
    for _ in range(TRIES_MAX):
        plan = _drawn(rng)
        if plan is not None and _is_clear(plan, seed):
            return plan
    raise ValueError(f"no plan found for seed {seed}")


def _drawn(rng: np.random.Generator) -> Plan | None:
    """Return a plan that need not be clear; None if it falls apart or has too few streets."""
    cells = [(column, row) for column in range(COLUMNS) for row in range(ROWS)]
    cells = [cells[k] for k in sorted(rng.permutation(len(cells))[:CAMERAS])]
    names = {cell: f"camera{number}" for number, cell in enumerate(cells, 1)}
    at = {
        cell: np.array(cell) * CELL_METRES + rng.uniform(-SHIFT_METRES, SHIFT_METRES, 2)
        for cell in cells
    }
    beside = [(a, b) for a, b in combinations(cells, 2) if abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1]

    # Two cameras side by side whose views overlap.
    rows = [(a, b) for a, b in beside if a[1] == b[1]]
    if rows and rng.random() < OVERLAP_SHARE:
        a, b = rows[int(rng.integers(len(rows)))]
        at[b] = at[a] + (OVERLAP_METRES, 0.0)

    # Paths between neighbours, and streets on the outer sides.
    ways = [(names[a], names[b]) for a, b in beside if rng.random() < PATH_SHARE]
    places = {names[cell]: (float(at[cell][0]), float(at[cell][1])) for cell in cells}
    streets = []
    for cell in cells:
        for side, step in _SIDES.items():
            outer = (cell[0] + step[0], cell[1] + step[1]) not in names
            if outer and rng.random() < STREET_SHARE:
                street = f"{names[cell]} {side}"
                end = at[cell] + STREET_METRES * np.array(step)
                places[street] = (float(end[0]), float(end[1]))
                ways.append((names[cell], street))
                streets.append(street)
    if len(streets) < STREETS_MIN or not _is_connected(list(places), ways):
        return None

    # Views, and the floor.
    headings = rng.integers(4, size=len(cells)) * math.pi / 2
    views = [
        View(names[cell], places[names[cell]], float(heading))
        for cell, heading in zip(cells, headings, strict=True)
    ]
    return Plan(places, ways, _areas(np.array(list(places.values())), rng), views)


def _areas(places: Floats, rng: np.random.Generator) -> list[Area]:
    """Return stone everywhere, and some rectangles of other floors on it."""
    (west, south), (east, north) = places.min(axis=0) - 12.0, places.max(axis=0) + 12.0
    areas = [Area("stone", (float(west), float(south), float(east), float(north)))]
    floors: tuple[Floor, ...] = ("grass", "wood", "brick")
    for floor in floors:
        x, y = rng.uniform((west, south), (east - 15.0, north - 12.0))
        wide, deep = rng.uniform((10.0, 8.0), (25.0, 15.0))
        areas.append(Area(floor, (float(x), float(y), float(x + wide), float(y + deep))))
    return areas


def _is_connected(places: list[str], ways: list[tuple[str, str]]) -> bool:
    """Return True if every place can be reached from every other one."""
    reachable = {places[0]}
    for _ in places:
        reachable |= {b for way in ways for a, b in (way, way[::-1]) if a in reachable}
    return len(reachable) == len(places)


def _is_clear(plan: Plan, seed: int) -> bool:
    """Return True if the zones of each view are apart, narrow, and used."""
    rng = np.random.default_rng(seed)
    walks = simulate_walks(plan, TRIAL_SECONDS, TRIAL_RATE, rng)
    all_passages = passages(plan, walks)
    truth = truth_of(plan, all_passages)
    # Nobody turns back, so who enters and leaves on the same path only grazes the view.
    if any(passage.way_in == passage.way_out for passage in all_passages):
        return False
    counts: dict[tuple[str, int], int] = {}
    for passage in all_passages:
        for way in (passage.way_in, passage.way_out):
            counts[passage.camera, way] = counts.get((passage.camera, way), 0) + 1
    if min(counts.values(), default=0) < PASSAGES_MIN:
        return False

    # Zones of each view: places that are apart, each narrow.
    by_camera: dict[str, list[Floats]] = {}
    for zone in truth.zones:
        if np.sqrt(np.diag(np.array(zone.cov)).max()) > SPREAD_MAX:
            return False
        by_camera.setdefault(zone.camera, []).append(np.array([zone.x, zone.y], dtype=float))
    return len(by_camera) == CAMERAS and all(
        len(places) > 1
        and all(np.linalg.norm(a - b) >= APART_MIN for a, b in combinations(places, 2))
        for places in by_camera.values()
    )
