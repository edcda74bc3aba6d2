"""An open square under strongly overlapping views: people stroll, stand and pass.

They walk alone or in groups. The square is open all round. Dwell times are long, and everybody is
in several views at once.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from bench.scenes.floor_plan import SPEED_SD, WALKING_SPEED, make_pieces, sampled, sightings, walk
from bench.scenes.hall import on_rim
from bench.scenes.recording import Faults, check, recorded
from camtopod.arrays import Floats
from camtopod.records import Event
from camtopod.sim.truth import Truth

PASSING, STROLLING = 0.4, 0.35
"""Shares of the groups that walk straight across, and that stop now and then; the rest stand."""
STROLL_FACTOR = 0.7
"""Speed of those who do not walk straight across, as a share of walking speed."""
STOP_SECONDS, STAND_SECONDS = (5.0, 40.0), (40.0, 200.0)
"""Ranges of the time of a stop, and of standing, seconds."""
GROUP_SIZES = (0.55, 0.3, 0.1, 0.05)
"""Shares of groups of 1, 2, 3 and 4."""
APART_METRES = 0.6
"""Standard deviation of the members' distances from the group's path, metres."""
WARM_UP_SECONDS = 300.0
"""Simulated seconds before the recording starts, so that the square is not empty then."""


class CrowdSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the simulation; times are seconds."""

    seed: int = 0
    people: float = 40.0
    """People on the square at once, on average."""
    seconds: float = 1200.0
    cameras: int = 7
    size: tuple[float, float] = (36.0, 12.0)
    """Width and depth of the square, metres."""
    frame: float = 0.5
    """Seconds between frames."""
    start: float = 1_700_000_000.0
    faults: Faults = Faults(broken_every=150.0)


def simulate_crowd(settings: CrowdSettings) -> tuple[list[Event], Truth]:
    """Return events sorted by time, and the ground truth (without zones and links).

    Raises ValueError for invalid settings, and if no suitable views are found.
    """
    check(settings, settings.faults, ("people", "seconds", "cameras", "frame"))
    structure, chance = (np.random.default_rng((settings.seed, 11, part)) for part in (1, 2))

    # Views, places where people stop, and how busy each part of the rim is.
    names = [f"square{number + 1}" for number in range(settings.cameras)]
    pieces = make_pieces(settings.size, names, (0.3, 0.7), (0.3, 1.0), structure)
    spots = structure.uniform((2.0, 2.0), np.array(settings.size) - 2.0, (5, 2))
    busy = structure.dirichlet(np.full(12, 1.5))

    # Walks of groups until there are enough people.
    knots: list[tuple[Floats, Floats]] = []
    presence = settings.people * (settings.seconds + WARM_UP_SECONDS)
    while presence > 0:
        begin = chance.uniform(-WARM_UP_SECONDS, settings.seconds)
        times, places = _group_walk(begin, busy, spots, settings.size, chance)
        for _ in range(1 + int(chance.choice(len(GROUP_SIZES), p=GROUP_SIZES))):
            beside = APART_METRES * chance.standard_normal(2)
            knots.append((times + chance.uniform(0.0, 1.0), places + beside))
            presence -= times[-1] - times[0]

    # Passages, and the events that cameras report.
    walks = sampled(knots, settings.size, settings.frame, settings.seconds)
    passages = sightings(pieces, walks, np.inf, chance)
    tracks = sightings(pieces, walks, settings.faults.broken_every, chance)
    return recorded(names, passages, tracks, settings.faults, settings.start, chance)


def _group_walk(
    begin: float, busy: Floats, spots: Floats, size: tuple[float, float], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return the knots of a group's walk from rim to rim; some parts of the rim are busier than
    others.
    """
    rim = 2 * (size[0] + size[1])
    origin, destination = (
        (rng.choice(len(busy), p=busy) + rng.random()) / len(busy) * rim for _ in range(2)
    )
    stops, waits = [on_rim(origin, size)], [0.0]
    manner = rng.random()
    if manner >= PASSING:
        standing = manner >= PASSING + STROLLING
        for _ in range(1 if standing else int(rng.integers(1, 4))):
            stops.append(spots[rng.integers(len(spots))] + 1.5 * rng.standard_normal(2))
            waits.append(rng.uniform(*(STAND_SECONDS if standing else STOP_SECONDS)))
    stops.append(on_rim(destination, size))
    waits.append(0.0)
    pace = WALKING_SPEED * (1.0 if manner < PASSING else STROLL_FACTOR)
    return walk(stops, waits, pace * float(np.exp(SPEED_SD * rng.standard_normal())), begin, rng)
