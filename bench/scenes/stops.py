"""People of the demo's site who stop on their way, and people who go in company."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from camtopod.sim.floor import FPS, Walk

STOP_SHARE, STOP_SECONDS = 0.6, (5.0, 40.0)
"""Share of the people who stop somewhere, and the range of how long, seconds."""
COMPANY_SHARE = 0.3
"""Share of the people with somebody at their side."""
BEHIND_SECONDS, ASIDE_METRES = (0.3, 1.0), 0.5
"""Range of how far that one is behind, seconds, and standard deviation of how far aside."""


def with_stops(walks: list[Walk], rng: np.random.Generator) -> list[Walk]:
    """Return the walks with stops, and those of the company."""
    result = []
    for walk in walks:
        if len(walk.t) and rng.random() < STOP_SHARE:
            at = int(rng.integers(len(walk.t)))
            repeats = np.ones(len(walk.t), dtype=np.int64)
            repeats[at] += round(rng.uniform(*STOP_SECONDS) * FPS)
            floor, way = np.repeat(walk.floor, repeats, axis=0), np.repeat(walk.way, repeats)
            walk = Walk(walk.t[0] + np.arange(len(way)) / FPS, floor, way)
        result.append(walk)
        if rng.random() < COMPANY_SHARE:
            behind = round(rng.uniform(*BEHIND_SECONDS) * FPS) / FPS
            aside = walk.floor + ASIDE_METRES * rng.standard_normal(2)
            result.append(replace(walk, t=walk.t + behind, floor=aside))
    return result
