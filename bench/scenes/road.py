"""Cameras along the streets of a town: vehicles without positions, in platoons from traffic lights.

Vehicles mostly go straight on and never turn round, so the camera before tells the next one. A
camera sees all directions of its street or crossing and cannot tell them apart.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from msgspec import Struct

from bench.scenes.recording import Faults, Sightings, check, recorded
from camtopod.arrays import Floats
from camtopod.records import Event
from camtopod.sim.truth import Truth

STREET_METRES = (200.0, 1200.0)
"""Range of the lengths of streets, metres."""
ONE_WAY_SHARE = 0.1
"""Share of the arterials with one-way traffic."""
STRAIGHT = 0.86
"""Share of the vehicles that go straight on at a crossing where they can."""
CROSSING_SHARE = 0.6
"""Share of the cameras at crossings; the others are in the middle of streets."""
BUSY_SD = 0.5
"""Spread of the traffic between arterials (log scale); both directions of one are alike."""
PARKS = 0.04
"""Share of the vehicles that end (and begin) their trip in a street."""
LIGHT_SECONDS, GREEN_SHARE = (60.0, 90.0), 0.5
"""Range of the cycle of traffic lights, seconds, and the share of it that is green."""
HEADWAY_SECONDS = 1.8
"""Seconds between two vehicles at a light."""
CAR_SPEED, BUS_SPEED, SPEED_SD = 11.0, 7.0, 0.12
"""Speeds, metres a second, and their spread between vehicles (log scale)."""
BUS_SHARE, BUS_STOP_SECONDS = 0.12, 25.0
"""Share of buses, and their mean time at a stop, seconds."""
VIEW_METRES, CLEAR_METRES = (15.0, 40.0), 90.0
"""Metres of street in view (twice that at crossings); least distance of others from a crossing."""
WARM_UP_SECONDS = 600.0
"""Simulated seconds before the recording starts, so that the streets are not empty then."""
CROSSINGS_MAX = 60
"""Most crossings of one trip."""

Node = tuple[int, int]
"""A crossing, or a point on the rim of the town."""


class RoadSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the simulation; times are seconds."""

    seed: int = 0
    per_second: float = 0.2
    """Vehicles that begin a trip, per second."""
    seconds: float = 7200.0
    cameras: int = 20
    grid: tuple[int, int] = (4, 5)
    """Arterials from north to south, and from west to east."""
    start: float = 1_700_000_000.0
    faults: Faults = Faults(missed=0.1, clutter=0.02, short=0.0)


@dataclass(frozen=True)
class Town:
    """Streets, cameras and traffic lights.

    metres: length of each directed street (from, to), between crossings or to the rim.
    cameras: cameras in streets, (camera, metres from the street's beginning).
    crossings: cameras at crossings.
    lights: cycle and offset of each crossing's lights, seconds.
    view_metres: length of each camera's view, metres.
    """

    metres: dict[tuple[Node, Node], float]
    cameras: dict[tuple[Node, Node], tuple[int, float]]
    crossings: dict[Node, int]
    lights: dict[Node, tuple[float, float]]
    view_metres: Floats


def simulate_road(settings: RoadSettings) -> tuple[list[Event], Truth]:
    """Return events sorted by time, and the ground truth (one zone per camera).

    Raises ValueError for invalid settings, and for more cameras than there are places.
    """
    check(settings, settings.faults, ("per_second", "seconds", "cameras"))
    structure, chance = (np.random.default_rng((settings.seed, 13, part)) for part in (1, 2))
    town = _town(settings, structure)
    names = [f"road{number + 1:02d}" for number in range(settings.cameras)]

    # Passages within the recording.
    rows = _drive(town, settings, structure, chance)
    table = np.array(rows, dtype=float).reshape(-1, 4)
    table = table[(table[:, 2] >= 0) & (table[:, 3] < settings.seconds)]
    vehicle, camera = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
    nowhere = np.full((len(vehicle), 2), np.nan)
    zone = np.unique(camera, return_inverse=True)[1]
    passages = Sightings(vehicle, camera, table[:, 2], table[:, 3], nowhere, nowhere, zone, zone)
    return recorded(names, passages, passages, settings.faults, settings.start, chance)


def _town(settings: RoadSettings, rng: np.random.Generator) -> Town:
    """Return arterials as a grid that extends to the rim, with cameras at random places.

    Some arterials are one-way.
    """
    # Streets and their lengths.
    columns, rows = settings.grid
    metres: dict[tuple[Node, Node], float] = {}
    lines = [[(x, y) for y in range(-1, rows + 1)] for x in range(columns)]
    lines += [[(x, y) for x in range(-1, columns + 1)] for y in range(rows)]
    low, high = np.log(STREET_METRES)
    east, south = (np.exp(rng.uniform(low, high, n + 1)) for n in settings.grid)
    for line in lines:
        one_way = rng.random() < ONE_WAY_SHARE
        ahead = line[::-1] if rng.random() < 0.5 else line
        for a, b in pairwise(ahead):
            length = float(
                east[1 + min(a[0], b[0])] if a[1] == b[1] else south[1 + min(a[1], b[1])]
            )
            metres[a, b] = length
            if not one_way:
                metres[b, a] = length

    # Places for cameras.
    crossings = sorted({node for way in metres for node in way if _inside(node, settings.grid)})
    streets = sorted(
        {
            (min(way), max(way))
            for way in metres
            if all(_inside(node, settings.grid) for node in way)
        }
    )
    at_crossings = round(CROSSING_SHARE * settings.cameras)
    if at_crossings > len(crossings) or settings.cameras - at_crossings > len(streets):
        raise ValueError(
            f"{settings.cameras} cameras are too many for {columns} x {rows} arterials"
        )

    # Cameras at crossings, then in streets.
    crossing_cameras = {
        crossings[k]: camera
        for camera, k in enumerate(rng.permutation(len(crossings))[:at_crossings])
    }
    cameras: dict[tuple[Node, Node], tuple[int, float]] = {}
    for camera, k in enumerate(
        rng.permutation(len(streets))[: settings.cameras - at_crossings], at_crossings
    ):
        a, b = streets[k]
        length = metres.get((a, b), metres.get((b, a), 0.0))
        place = rng.uniform(CLEAR_METRES, length - CLEAR_METRES)
        cameras[a, b], cameras[b, a] = (camera, place), (camera, length - place)
    lights = {
        node: (float(rng.uniform(*LIGHT_SECONDS)), float(rng.uniform(0.0, 90.0)))
        for node in crossings
    }
    return Town(
        metres, cameras, crossing_cameras, lights, rng.uniform(*VIEW_METRES, settings.cameras)
    )


def _inside(node: Node, grid: tuple[int, int]) -> bool:
    """Return True if a node is a crossing, not on the rim."""
    return 0 <= node[0] < grid[0] and 0 <= node[1] < grid[1]


def _drive(
    town: Town, settings: RoadSettings, structure: np.random.Generator, rng: np.random.Generator
) -> list[tuple[int, int, float, float]]:
    """Return all passages (vehicle, camera, seconds in, seconds out).

    Vehicles are moved in order of time, as they queue at the lights.
    """
    # Traffic of each street.
    ways = sorted(town.metres)
    busy = np.array([(1.0 if not _inside(a, settings.grid) else PARKS) for a, _ in ways])
    arterial = {
        line: np.exp(BUSY_SD * structure.standard_normal())
        for line in range(2 * sum(settings.grid))
    }
    busy *= [arterial[a[0] if a[0] == b[0] else settings.grid[0] + a[1]] for a, b in ways]

    # Vehicles and where they begin.
    n = rng.poisson(settings.per_second * (settings.seconds + WARM_UP_SECONDS))
    bus = rng.random(n) < BUS_SHARE
    speed = np.where(bus, BUS_SPEED, CAR_SPEED) * np.exp(SPEED_SD * rng.standard_normal(n))
    turns = {way: _turns(town, way, structure) for way in ways}
    begin = rng.uniform(-WARM_UP_SECONDS, settings.seconds, n)
    heap = [
        (float(begin[k]), k, ways[way], 0)
        for k, way in enumerate(rng.choice(len(ways), n, p=busy / busy.sum()))
    ]
    heapq.heapify(heap)

    # Move each vehicle to the next crossing.
    free: dict[tuple[Node, Node], float] = {}
    passages = []
    while heap:
        t, vehicle, way, crossings = heapq.heappop(heap)
        pace = speed[vehicle] * math.exp(0.05 * rng.standard_normal())
        stop = rng.exponential(BUS_STOP_SECONDS) if bus[vehicle] and rng.random() < 0.5 else 0.0
        if way in town.cameras:
            camera, place = town.cameras[way]
            passages.append(
                (vehicle, camera, t + place / pace, t + (place + town.view_metres[camera]) / pace)
            )
        targets, share = turns[way]
        if not targets or crossings >= CROSSINGS_MAX or rng.random() < PARKS:
            continue
        arrives = t + town.metres[way] / pace + stop
        free[way] = _green(
            town.lights[way[1]], way, max(arrives, free.get(way, -math.inf) + HEADWAY_SECONDS)
        )
        if way[1] in town.crossings:
            camera = town.crossings[way[1]]
            passages.append(
                (vehicle, camera, free[way], free[way] + 2 * town.view_metres[camera] / pace)
            )
        onward = way[1], targets[int(rng.choice(len(targets), p=share))]
        heapq.heappush(heap, (free[way], vehicle, onward, crossings + 1))
    return passages


def _turns(
    town: Town, way: tuple[Node, Node], rng: np.random.Generator
) -> tuple[list[Node], Floats]:
    """Return the next nodes at the end of a street and their shares.

    Most vehicles go straight on; none turns back.
    """
    a, b = way
    straight = (2 * b[0] - a[0], 2 * b[1] - a[1])
    targets = sorted(v for u, v in town.metres if u == b and v != a)
    if not targets:
        return [], np.zeros(0)
    weight = rng.dirichlet(np.full(len(targets), 2.0)) * (1 - STRAIGHT)
    weight[[v == straight for v in targets]] = STRAIGHT
    return targets, weight / weight.sum()


def _green(light: tuple[float, float], way: tuple[Node, Node], t: float) -> float:
    """Return the first moment from ``t`` on at which a street's light is green.

    The two crossing streets take turns.
    """
    cycle, offset = light
    offset += 0.0 if way[0][0] == way[1][0] else GREEN_SHARE * cycle
    phase = (t - offset) % cycle
    return t if phase < GREEN_SHARE * cycle else t - phase + cycle
