"""Cameras along the walkways of a campus: few people, views far apart, recordings with gaps.

Paths join the views in a tree with a few branches. Most are walked through; on some people sit down
or talk, so that transit times spread widely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec import Struct

from bench.scenes.recording import Faults, Sightings, broken, check, clipped, recorded
from camtopod.arrays import Floats
from camtopod.records import Event
from camtopod.sim.truth import Truth

SIDES = (
    ((0.03, 0.7), (0.015, 0.08)),
    ((0.97, 0.7), (0.015, 0.08)),
    ((0.5, 0.97), (0.12, 0.012)),
    ((0.45, 0.42), (0.05, 0.02)),
)
"""Where paths cut a picture (left, right, bottom, far): centre and standard deviations (x, y)."""
WAY_SECONDS, BROAD_SECONDS = (10.0, 90.0), 9.0
"""Range of the transit times of paths, and transit time of a broad path, seconds."""
BROAD_SHARE, BROAD_STOP_SECONDS = 0.35, 63.0
"""Share of the paths that are broad, and how long people stop there at most, seconds."""
VIEW_SECONDS = (5.0, 20.0)
"""Range of the dwell times, seconds."""
SPEED_SD, PATH_SD = 0.15, 0.06
"""Spread of the speed between people, and of one person's between paths (log scale)."""
STREET = -1
"""Stands for a camera at the outer end of a path."""
LEAVES = 0.06
"""Share of the people that go into a building on a path."""
U_TURN = 0.08
"""Weight of turning back, as a multiple of the weights of all sides."""
PAUSE_SHARE, PAUSE_SECONDS = 0.06, (10.0, 90.0)
"""Share of the passages in which people stop in view, and the range of how long, seconds."""
PASSAGES_MAX = 30
"""Most passages of one person."""
CLASS_SHARE, CLASS_SECONDS = 0.4, 120.0
"""Share of the people that come when a class ends, and within how many seconds."""


class WalkwaySettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the simulation; times are seconds."""

    seed: int = 0
    walkers_per_hour: float = 225.0
    seconds: float = 2400.0
    cameras: int = 6
    together: float = 0.25
    """Share of the walkers in pairs."""
    gaps: bool = True
    """Whether cameras begin late, end early or pause."""
    start: float = 1_700_000_000.0
    faults: Faults = Faults(broken_every=200.0, clutter=0.04)


@dataclass(frozen=True)
class Campus:
    """Paths between cameras.

    ways[camera]: the paths at a camera's sides, (camera at the other end or `STREET`, its side,
        seconds, broad).
    weight[camera]: how busy each of them is.
    """

    ways: list[list[tuple[int, int, float, bool]]]
    weight: list[Floats]


def simulate_walkway(settings: WalkwaySettings) -> tuple[list[Event], Truth]:
    """Return events sorted by time, and the ground truth.

    Raises ValueError for invalid settings.
    """
    check(settings, settings.faults, ("walkers_per_hour", "seconds", "cameras"))
    structure, chance = (np.random.default_rng((settings.seed, 12, part)) for part in (1, 2))

    # Passages, with consecutive zone numbers.
    names = [f"way{number + 1}" for number in range(settings.cameras)]
    campus = _campus(settings.cameras, structure)
    passages = _walk(campus, settings, chance)
    zones, number = np.unique(np.stack([passages.zone_in, passages.zone_out]), return_inverse=True)
    passages.zone_in, passages.zone_out = number.reshape(2, -1)
    assert len(zones) <= settings.cameras * len(SIDES)

    # Events that cameras report.
    tracks = clipped(passages, _on_air(settings, structure))
    tracks = broken(tracks, settings.faults.broken_every, chance)
    return recorded(names, passages, tracks, settings.faults, settings.start, chance)


def _campus(cameras: int, rng: np.random.Generator) -> Campus:
    """Return a random tree of cameras, a path that closes a cycle, and paths to streets."""
    ways: list[list[tuple[int, int, float, bool]]] = [[] for _ in range(cameras)]

    def join(a: int, b: int) -> None:
        broad = bool(rng.random() < BROAD_SHARE)
        seconds = BROAD_SECONDS if broad else float(np.exp(rng.uniform(*np.log(WAY_SECONDS))))
        side_a, side_b = len(ways[a]), len(ways[b])
        ways[a].append((b, side_b, seconds, broad))
        ways[b].append((a, side_a, seconds, broad))

    for camera in range(1, cameras):
        near = [number for number in range(max(0, camera - 3), camera) if len(ways[number]) < 3]
        join(int(rng.choice(near)), camera)
    if cameras > 3 and len(ways[0]) < 3 and len(ways[-1]) < 3:
        join(0, cameras - 1)
    for camera_ways in ways:
        if len(camera_ways) < 2 or (len(camera_ways) == 2 and rng.random() < 0.4):
            camera_ways.append((STREET, 0, 0.0, False))
    weight = [np.exp(0.6 * rng.standard_normal(len(camera_ways))) for camera_ways in ways]
    return Campus(ways, weight)


def _walk(campus: Campus, settings: WalkwaySettings, rng: np.random.Generator) -> Sightings:
    """Return all passages; zone numbers are ``4 * camera + side``.

    The sides of a camera are in random order.
    """
    streets = [
        (c, s)
        for c, camera_ways in enumerate(campus.ways)
        for s, way in enumerate(camera_ways)
        if way[0] == STREET
    ]
    sides = [rng.permutation(len(SIDES)) for _ in campus.ways]
    busy = rng.dirichlet(np.full(len(streets), 2.0))
    classes = rng.uniform(0.0, settings.seconds, max(1, round(settings.seconds / 900.0)))

    # Walks, alone or in pairs.
    rows: list[tuple[int, int, float, float, int, int]] = []
    walkers, person = rng.poisson(settings.walkers_per_hour * settings.seconds / 3600.0), 0
    while person < walkers:
        begin = rng.uniform(-120.0, settings.seconds - 60.0)
        if rng.random() < CLASS_SHARE:
            begin = float(rng.choice(classes)) + CLASS_SECONDS * rng.random()
        camera, side = streets[int(rng.choice(len(streets), p=busy))]
        passages = _walk_passages(campus, camera, side, begin, rng)
        rows += [(person, *passage) for passage in passages]
        person += 1
        if rng.random() < settings.together / 2:
            aside = rng.uniform(0.2, 1.0)
            rows += [
                (person, c, t_in + aside, t_out + aside * rng.uniform(0.5, 1.5), a, b)
                for c, t_in, t_out, a, b in passages
            ]
            person += 1

    # Passages as columns, within the recording.
    columns = np.array(rows, dtype=float).T
    persons, camera_of, way_in, way_out = (columns[k].astype(np.int64) for k in (0, 1, 4, 5))
    t_in, t_out = columns[2], columns[3]
    inside = (t_out > 0) & (t_in < settings.seconds)
    order = np.array(sides)
    side_in, side_out = order[camera_of, way_in], order[camera_of, way_out]
    centre, spread = np.array([side[0] for side in SIDES]), np.array([side[1] for side in SIDES])
    noise_in, noise_out = rng.standard_normal((2, len(persons), 2))
    return Sightings(
        person=persons,
        camera=camera_of,
        t_in=t_in,
        t_out=t_out,
        at_in=centre[side_in] + spread[side_in] * noise_in,
        at_out=centre[side_out] + spread[side_out] * noise_out,
        zone_in=len(SIDES) * camera_of + side_in,
        zone_out=len(SIDES) * camera_of + side_out,
    ).take(inside)


def _walk_passages(
    campus: Campus, camera: int, side: int, t: float, rng: np.random.Generator
) -> list[tuple[int, float, float, int, int]]:
    """Return one walk: (camera, seconds in, seconds out, side in, side out) of each passage."""
    speed = float(np.exp(SPEED_SD * rng.standard_normal()))
    result: list[tuple[int, float, float, int, int]] = []
    while len(result) < PASSAGES_MAX:
        weight = campus.weight[camera].copy()
        weight[side] = U_TURN * weight.sum() if len(weight) > 1 else 1.0
        out = int(rng.choice(len(weight), p=weight / weight.sum()))
        stay = rng.uniform(*VIEW_SECONDS) / speed
        if rng.random() < PAUSE_SHARE:
            stay += rng.uniform(*PAUSE_SECONDS)
        result.append((camera, t, t + stay, side, out))
        target, next_side, seconds, broad = campus.ways[camera][out]
        if target == STREET or rng.random() < LEAVES:
            break
        way = seconds / speed * float(np.exp(PATH_SD * rng.standard_normal()))
        if broad:
            way += rng.uniform(0.0, BROAD_STOP_SECONDS)
        camera, side, t = target, next_side, t + stay + way
    return result


def _on_air(settings: WalkwaySettings, rng: np.random.Generator) -> list[tuple[int, float, float]]:
    """Return when cameras record, (camera, from, to).

    All begin at differing times; one ends early, one pauses long, one begins late.
    """
    end = settings.seconds
    if not settings.gaps:
        return [(camera, 0.0, end) for camera in range(settings.cameras)]
    result = []
    manner = rng.permutation(settings.cameras)
    for camera in range(settings.cameras):
        begin = end * rng.uniform(0.0, 0.05)
        if manner[camera] == 0:
            result.append((camera, begin, end * rng.uniform(0.5, 0.75)))
        elif manner[camera] == 1:
            pause = end * rng.uniform(0.3, 0.5)
            result += [(camera, begin, pause), (camera, pause + end * rng.uniform(0.2, 0.35), end)]
        elif manner[camera] == 2:
            result.append((camera, end * rng.uniform(0.15, 0.35), end))
        else:
            result.append((camera, begin, end * rng.uniform(0.95, 1.0)))
    return result
