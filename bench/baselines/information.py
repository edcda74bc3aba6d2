"""Mutual information of departure and arrival times, correspondence unknown (Tieu, Dalley, Grimson,
ICCV 2005).

Departure X and arrival Y of one object depend on each other through the transit time T = Y - X, and
``I(X; Y) = h(Y) - h(T)``: how much better than at chance the departure tells the arrival. Who
belongs to whom is not known; the paper samples correspondences by Markov chain Monte Carlo, one
pair of zones at a time, with a nonparametric density of T. Here their expectation is taken by EM,
the same model at a price that dense traffic can pay: an arrival has at most one departure, a
departure at most one arrival, both may be unmatched. Being pairwise, it cannot tell an indirect
link from a direct one.
"""

from __future__ import annotations

import numpy as np

from bench.baselines.crossings import Candidates, Crossings
from bench.baselines.findings import Findings
from camtopod.arrays import Floats

ITERATIONS = 12
BIN_SECONDS = 2.0
SMOOTHING_SD_BINS = 1.0
MATCHED_START = 0.3
"""Share of the departures matched at first, at any lag."""


def information(seen: Crossings, found: Candidates) -> dict[str, Findings]:
    """Scores: information per departure, in total, and the matched pairs' alone; nats."""
    (low, high), zones = found.lags, len(seen.zones)
    span = high - low
    bins = round(span / BIN_SECONDS)
    width = span / bins
    leaving = np.maximum(np.bincount(seen.left_zone, minlength=zones), 1).astype(float)
    coming = np.bincount(seen.came_zone, minlength=zones).astype(float)
    seconds = max(float(seen.came[-1] - seen.came[0]), 1.0) if len(seen.came) else 1.0
    at = np.minimum(((found.lag - low) / width).astype(np.int64), bins - 1)
    key = found.pair * bins + at
    by_arrival = found.arrival * zones + found.pair // zones
    by_departure = found.departure * zones + found.pair % zones
    hazard = np.full((zones * zones, bins), MATCHED_START / span)
    spread = _smoother(bins)
    mass = np.zeros((zones * zones, bins))
    for _ in range(ITERATIONS):
        left_over = (
            np.maximum(coming - mass.sum(axis=1).reshape(zones, zones), 0.05 * coming) / seconds
        )
        density = hazard.ravel()[key]
        rivals = (
            np.bincount(by_arrival, density)[by_arrival]
            + np.bincount(by_departure, density)[by_departure]
        )
        share = density / np.maximum(left_over.ravel()[found.pair] + rivals - density, 1e-12)
        mass = np.bincount(key, share, minlength=zones * zones * bins).reshape(-1, bins) @ spread
        hazard = mass / (np.repeat(leaving, zones)[:, None] * width)
    matched = mass.sum(axis=1)
    shape = np.divide(mass, matched[:, None], out=np.zeros_like(mass), where=matched[:, None] > 0)
    gain = (shape * np.log(np.maximum(shape * bins, 1e-12))).sum(axis=1)  # h(chance) - h(T)
    matched, gain = matched.reshape(zones, zones), gain.reshape(zones, zones)
    centres = low + width * (np.arange(bins) + 0.5)
    transit = centres[mass.argmax(axis=1)].reshape(zones, zones)
    return {
        "per departure": Findings(matched / leaving[:, None] * gain, transit),
        "in total": Findings(matched * gain, transit),
        "of the matched": Findings(np.where(matched > 2, gain, -np.inf), transit),
    }


def _smoother(bins: int) -> Floats:
    """Parzen window over the lag bins; keeps mass."""
    offset = np.arange(bins)[:, None] - np.arange(bins)[None, :]
    kernel: Floats = np.exp(-0.5 * (offset / SMOOTHING_SD_BINS) ** 2)
    kernel /= kernel.sum(axis=1, keepdims=True)
    return kernel
