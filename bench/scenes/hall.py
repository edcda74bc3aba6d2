"""A station hall under overlapping views: people come from doors and trains, some queue or shop.

Views have open borders: nobody has to pass a door to enter or leave one. People are in several
views at once.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from bench.scenes.floor_plan import SPEED_SD, WALKING_SPEED, make_pieces, sampled, sightings, walk
from bench.scenes.recording import Faults, check, recorded
from camtopod.arrays import Floats
from camtopod.records import Event
from camtopod.sim.truth import Truth

DOORS = (8, 12)
"""Least and largest number of doors."""
COUNTERS = 6
"""Shops and ticket machines at which people stop."""
DOOR_METRES = (1.5, 4.0)
"""Range of the width of a door, metres."""
COUNTER_SHARE, SECOND_COUNTER_SHARE = 0.3, 0.25
"""Share of the people that stop at a counter, and share of these that stop at a second one."""
WAIT_SECONDS = (5.0, 120.0)
"""Range of the time at a counter, seconds."""
WARM_UP_SECONDS = 120.0
"""Simulated seconds before the recording starts, so that the hall is not empty then."""
PLATFORM_DOORS = 3
"""Doors that lead to platforms."""
TRAIN_SECONDS, TRAIN_SPREAD_SECONDS = 240.0, 25.0
"""Mean time between trains, and time in which most people of one come out, seconds."""


class HallSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the simulation; times are seconds."""

    seed: int = 0
    walkers_per_hour: float = 2400.0
    seconds: float = 2400.0
    cameras: int = 7
    size: tuple[float, float] = (40.0, 30.0)
    """Width and depth of the hall, metres."""
    train_share: float = 0.4
    """Share of the walkers that come off a train."""
    frame: float = 0.2
    """Seconds between frames."""
    start: float = 1_700_000_000.0
    faults: Faults = Faults()


def simulate_hall(settings: HallSettings) -> tuple[list[Event], Truth]:
    """Return events sorted by time, and the ground truth (without zones and links).

    Raises ValueError for invalid settings, and if no suitable views are found.
    """
    check(settings, settings.faults, ("walkers_per_hour", "seconds", "cameras", "frame"))
    structure, chance = (np.random.default_rng((settings.seed, 10, part)) for part in (1, 2))

    # Views, doors, counters and the flow between doors.
    names = [f"hall{number + 1}" for number in range(settings.cameras)]
    pieces = make_pieces(settings.size, names, (0.1, 0.35), (0.15, 0.75), structure)
    doors, widths = _rim(int(structure.integers(*DOORS, endpoint=True)), settings.size, structure)
    counters = structure.uniform(
        np.array(settings.size) * 0.1, np.array(settings.size) * 0.9, (COUNTERS, 2)
    )
    flow = _flow(len(doors), structure)

    # Walks from door to door.
    begin, origin = _arrivals(settings, flow, chance)
    knots = []
    for t, door in zip(begin, origin, strict=True):
        goal = int(chance.choice(len(doors), p=flow[door] / flow[door].sum()))
        stops, waits = [_through(doors, widths, door, settings.size, chance)], [0.0]
        if chance.random() < COUNTER_SHARE:
            visits = 1 + int(chance.random() < SECOND_COUNTER_SHARE)
            for counter in chance.choice(COUNTERS, visits, replace=False):
                stops.append(counters[counter] + 0.7 * chance.standard_normal(2))
                waits.append(float(np.exp(chance.uniform(*np.log(WAIT_SECONDS)))))
        stops.append(_through(doors, widths, goal, settings.size, chance))
        waits.append(0.0)
        speed = WALKING_SPEED * float(np.exp(SPEED_SD * chance.standard_normal()))
        knots.append(walk(stops, waits, speed, float(t), chance))

    # Passages, and the events that cameras report.
    walks = sampled(knots, settings.size, settings.frame, settings.seconds)
    passages = sightings(pieces, walks, np.inf, chance)
    tracks = sightings(pieces, walks, settings.faults.broken_every, chance)
    return recorded(names, passages, tracks, settings.faults, settings.start, chance)


def _rim(count: int, size: tuple[float, float], rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the doors' places along the rim (metres from a corner) and their widths."""
    length = 2 * (size[0] + size[1])
    spread = (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    return spread * length % length, rng.uniform(*DOOR_METRES, count)


def on_rim(place: float, size: tuple[float, float]) -> Floats:
    """Return the point ``place`` metres along the rim of a floor, (2,)."""
    width, depth = size
    place %= 2 * (width + depth)
    if place < width:
        return np.array((place, 0.0))
    if place < width + depth:
        return np.array((width, place - width))
    if place < 2 * width + depth:
        return np.array((2 * width + depth - place, depth))
    return np.array((0.0, 2 * (width + depth) - place))


def _through(
    doors: Floats, widths: Floats, door: int, size: tuple[float, float], rng: np.random.Generator
) -> Floats:
    """Return a random point in a door."""
    return on_rim(float(doors[door] + widths[door] * rng.uniform(-0.5, 0.5)), size)


def _flow(doors: int, rng: np.random.Generator) -> Floats:
    """Return the shares of people by door of entry and exit, (doors, doors).

    Some doors and some pairs of doors are far busier than others.
    """
    busy = np.exp(0.8 * rng.standard_normal(doors))
    flow = np.outer(busy, busy) * np.exp(0.8 * rng.standard_normal((doors, doors)))
    np.fill_diagonal(flow, 0.02 * flow.mean())
    result: Floats = flow / flow.sum()
    return result


def _arrivals(
    settings: HallSettings, flow: Floats, rng: np.random.Generator
) -> tuple[Floats, list[int]]:
    """Return when and at which door people come.

    They come off trains in platoons at the first doors, or one by one.
    """
    walkers = rng.poisson(settings.walkers_per_hour * (settings.seconds + WARM_UP_SECONDS) / 3600.0)
    by_train = rng.random(walkers) < settings.train_share
    begin = rng.uniform(-WARM_UP_SECONDS, settings.seconds, walkers)

    # Trains: time, share of the people, platform.
    trains = rng.uniform(
        -WARM_UP_SECONDS, settings.seconds, max(1, round(settings.seconds / TRAIN_SECONDS))
    )
    size = rng.dirichlet(np.full(len(trains), 3.0))
    train = rng.choice(len(trains), walkers, p=size)
    platform = rng.integers(0, PLATFORM_DOORS, len(trains))
    late = TRAIN_SPREAD_SECONDS * rng.gamma(2.0, 0.5, walkers)
    begin = np.where(by_train, trains[train] + late, begin)
    door = rng.choice(len(flow), walkers, p=flow.sum(1))
    return begin, [int(d) for d in np.where(by_train, platform[train], door)]
