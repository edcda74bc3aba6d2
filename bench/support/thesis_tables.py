"""The thesis's tables, and a simulation after its figure 4.4; for tests and the bench."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats

TABLE_5_1 = [
    *((0, 12, 2), (11, 13, 1), (0, 16, 2), (11, 14, 1), (0, 7, 2)),
    *((11, 13, 1), (0, 7, 2), (11, 12, 1), (1, 17, 2), (11, 13, 1)),
    *((0, 18, 2), (11, 13, 1), (0, 16, 2), (1, 17, 2), (11, 13, 1)),
]
"""Row, column and zone of each event."""

TABLE_5_2 = np.array(
    [
        [0, 7.8102, 12.35, 0.95, 19.95, 17.1, 25.65, 21.85],
        [7.8102, 0, 2.3, 8.25, 29.45, 9.1, 0, 0],
        [12.35, 2.3, 0, 10.5, 1.65, 26.6, 0, 0],
        [0.95, 8.25, 10.5, 0, 11.55, 16.15, 14.85, 20.9],
        [19.95, 29.45, 1.65, 11.55, 0, 5.1, 3.9, 0.991],
        [17.1, 26.6, 26.6, 16.15, 5.1, 0, 0.55, 3.95],
        [25.65, 0, 0, 14.85, 3.9, 0.55, 0, 4.9167],
        [21.85, 0, 0, 20.9, 0.991, 3.95, 4.9167, 0],
    ]
)
"""Transit times between zones, seconds; 0 where there is no link."""
TABLE_5_2_CAMERAS = [1, 1, 2, 2, 3, 3, 4, 4]
"""Camera of each zone of table 5.2."""
TABLE_5_3 = [
    (2, 1, 3, 4, 2, 2.3, 8.25, 10.5),
    (3, 4, 5, 6, 8, 0.991, 3.95, 5.1),
    (4, 3, 7, 8, 5, 3.9, 0.991, 4.9167),
]
"""Camera of A and B, camera of C, zones A, B, C, transit times C-A, C-B, A-B; T = 0.200."""
TABLE_5_4_CAMERAS = [1, 1, 2, 2, 3, 3, 3, 4, 4, 5, 5, 5, 5]
"""Camera of each zone of table 5.4."""
TABLE_5_4 = [
    (1, 2, 1, 2, 3, 9.9, 2.85, 13.0),
    (2, 1, 3, 4, 1, 10.2, 3.0, 13.0),
    (2, 1, 3, 4, 2, 2.85, 10.5, 13.0),
    (2, 5, 3, 4, 10, 11.75, 1.05, 13.0),
    (2, 5, 3, 4, 11, 9.75, 3.05, 13.0),
    (3, 4, 6, 7, 9, 1.6, 3.3, 4.45),
    (5, 1, 10, 11, 1, 2.0, 0.35, 2.0),
    (5, 3, 12, 13, 6, 3.55, 1.15, 4.7),
    (5, 4, 12, 13, 9, 3.7, 7.55, 10.65),
]
"""Columns as in table 5.3; T = 0.450.

The figures of the last row contradict it: |10.65 - (3.7 + 7.55)| = 0.60. Its A-B also differs from
that of the row before (4.7), which has the same pair of zones.
"""

FIGURE_4_4_ZONES = (3, 2, 3, 3, 2)
"""Zones of each of the five cameras, thirteen in all."""
FIGURE_4_4_AGENTS = 3000
"""Agents in the simulation."""


def table_5_4_transit(row: tuple[int, int, int, int, int, float, float, float]) -> Floats:
    """Return the transit times of one row of table 5.4, 0 elsewhere, shape (13, 13).

    Rows are taken one at a time, as the last two contradict each other: from 12 to 13 takes 4.7 and
    10.65.
    """
    transit = np.zeros((13, 13))
    _, _, a, b, c, ca, cb, ab = row
    for i, j, seconds in ((c, a, ca), (c, b, cb), (a, b, ab)):
        transit[i - 1, j - 1] = transit[j - 1, i - 1] = seconds
    return transit


def figure_4_4(seed: int, clutter: float = 0.0) -> tuple[list[Floats], list[NDArray[np.intp]]]:
    """Simulate events of 3,000 agents in five cameras with thirteen zones.

    Returns the positions (n, 2) of each camera, and the zone of each event (-1 for clutter). Every
    agent has its own speed and walks through three cameras, in at one zone and out at another.
    Faster agents are further inside the view at the first and last sighting, so zones are long
    rather than round. Zones may be as close as 0.12 of the image, as along a corridor.
    """
    rng = np.random.default_rng(seed)
    doors = [_doors(rng, zones) for zones in FIGURE_4_4_ZONES]
    speed = 0.03 * np.exp(0.4 * rng.standard_normal(FIGURE_4_4_AGENTS))
    places: list[list[Floats]] = [[] for _ in FIGURE_4_4_ZONES]
    zones: list[list[int]] = [[] for _ in FIGURE_4_4_ZONES]

    # Entry and exit of each passage.
    for agent in range(FIGURE_4_4_AGENTS):
        for camera in rng.choice(5, 3, replace=False):
            door, inwards, spread = doors[camera]
            for zone in rng.choice(len(door), 2, replace=False):
                along = speed[agent] * rng.random()
                places[camera].append(
                    door[zone] + along * inwards[zone] + spread[zone] * rng.standard_normal(2)
                )
                zones[camera].append(int(zone))

    # Add clutter.
    positions, labels = [], []
    for place, zone_of in zip(places, zones, strict=True):
        noise = int(clutter / (1 - clutter) * len(place))
        positions.append(np.clip(np.concatenate([np.array(place), rng.random((noise, 2))]), 0, 1))
        labels.append(np.concatenate([np.array(zone_of), np.full(noise, -1)]).astype(np.intp))
    return positions, labels


def _doors(rng: np.random.Generator, zones: int) -> tuple[Floats, Floats, Floats]:
    """Return the zones' places, the directions into the view, and the spreads of sightings."""
    places: list[Floats] = []
    while len(places) < zones:
        place = rng.uniform(0.08, 0.92, 2)
        if all(np.hypot(*(place - other_place)) >= 0.12 for other_place in places):
            places.append(place)
    angle = rng.uniform(0, 2 * np.pi, zones)
    return (
        np.array(places),
        np.stack([np.cos(angle), np.sin(angle)], axis=1),
        rng.uniform(0.008, 0.015, zones),
    )
