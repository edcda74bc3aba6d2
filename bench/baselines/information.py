"""Mutual information of departure and arrival times, with unknown correspondence.

Tieu, Dalley, Grimson, "Inference of non-overlapping camera network topology by measuring
statistical dependence", ICCV 2005. Departure X and arrival Y of one object depend on each other
through the transit time T = Y - X, and ``I(X; Y) = h(Y) - h(T)``. The paper samples the unknown
correspondences by Markov chain Monte Carlo, one pair of zones at a time, with a nonparametric
density of T. Here EM takes their expectation in the same model, which is affordable in dense
traffic: an arrival has at most one departure, a departure at most one arrival, and both may be
unmatched. As the method is pairwise, it cannot tell an indirect link from a direct one.
"""

from __future__ import annotations

import numpy as np

from bench.baselines.crossings import Candidates, Crossings, smoother
from bench.baselines.findings import Findings

ITERATIONS = 12
BIN_SECONDS = 2.0
"""Width of a lag bin, seconds."""
SMOOTHING_SD_BINS = 1.0
"""Standard deviation of the Parzen window, in bins."""
MATCHED_START = 0.3
"""Share of the exits that are matched at the start, spread evenly over the lags."""


def information(traffic: Crossings, candidates: Candidates) -> dict[str, Findings]:
    """Return three scores of each pair, nats: per departure, in total, and per matched pair."""
    # Bins of lags; traffic of each zone; the keys by which candidates are summed.
    (low, high), zones = candidates.lags, len(traffic.zones)
    span = high - low
    bins = round(span / BIN_SECONDS)
    width = span / bins
    exit_counts = np.maximum(np.bincount(traffic.exit_zone, minlength=zones), 1).astype(float)
    entry_counts = np.bincount(traffic.entry_zone, minlength=zones).astype(float)
    seconds = (
        max(float(traffic.entries[-1] - traffic.entries[0]), 1.0) if len(traffic.entries) else 1.0
    )
    at = np.minimum(((candidates.lag - low) / width).astype(np.int64), bins - 1)
    key = candidates.pair * bins + at
    by_arrival = candidates.arrival * zones + candidates.pair // zones
    by_departure = candidates.departure * zones + candidates.pair % zones
    hazard = np.full((zones * zones, bins), MATCHED_START / span)
    spread = smoother(bins, SMOOTHING_SD_BINS)
    mass = np.zeros((zones * zones, bins))

    # EM: E step (share of each candidate), M step (smoothed mass and hazard).
    for _ in range(ITERATIONS):
        left_over = (
            np.maximum(entry_counts - mass.sum(axis=1).reshape(zones, zones), 0.05 * entry_counts)
            / seconds
        )
        density = hazard.ravel()[key]
        rivals = (
            np.bincount(by_arrival, density)[by_arrival]
            + np.bincount(by_departure, density)[by_departure]
        )
        share = density / np.maximum(left_over.ravel()[candidates.pair] + rivals - density, 1e-12)
        mass = np.bincount(key, share, minlength=zones * zones * bins).reshape(-1, bins) @ spread
        hazard = mass / (np.repeat(exit_counts, zones)[:, None] * width)

    # Information gain of each pair against a uniform lag.
    matches = mass.sum(axis=1)
    shape = np.divide(mass, matches[:, None], out=np.zeros_like(mass), where=matches[:, None] > 0)
    gain = (shape * np.log(np.maximum(shape * bins, 1e-12))).sum(axis=1)  # h(uniform) - h(T)
    matches, gain = matches.reshape(zones, zones), gain.reshape(zones, zones)
    centres = low + width * (np.arange(bins) + 0.5)
    transit = centres[mass.argmax(axis=1)].reshape(zones, zones)
    return {
        "per departure": Findings(matches / exit_counts[:, None] * gain, transit),
        "in total": Findings(matches * gain, transit),
        "of the matched": Findings(np.where(matches > 2, gain, -np.inf), transit),
    }
