"""Markov chains from anonymous counts: conditional least squares with transit delays.

Bernstein and Sheldon, "Consistently estimating Markov chains with noisy aggregate data" (AISTATS
2016), after Kalbfleisch and Lawless: from counts of people by state and time step, without
identities, the transition matrix is estimated by non-negative regression of the counts of a step on
those of the step before. Martin, Pryer and Zanetti (arXiv 2501.17532, 2025) treat the same problem;
their paper was not available, so this is not their estimator. Here a step is two seconds, the next
state follows after any of many delays, and a moving average stands for newcomers:

    arrivals_v(t) - average = sum_u sum_d p_uv(d) (departures_u(t - d) - average) + noise,
    p_uv(d) >= 0.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from bench.baselines.crossings import NARROW, Crossings, Lags
from bench.baselines.findings import Findings
from camtopod.arrays import Floats

STEP_SECONDS = 2.0
"""Length of a time step, seconds."""
GROUPS = (
    *(
        -120,
        -90,
        -64,
        -44,
        -30,
        -20,
        -12,
        -8,
        -6,
        -4,
        -2,
        0,
        2,
        4,
        6,
        8,
        12,
        16,
        20,
        26,
        32,
        40,
        50,
        64,
        80,
        100,
        120,
    ),
    *(150, 180),
)
"""Limits of the groups of delays, seconds; within a group ``p_uv(d)`` is constant."""
AVERAGE_SECONDS = 1200.0
"""Length of the moving average, seconds."""
RIDGE = 1.0
"""Ridge penalty, as a share of the diagonal to which it is added."""
ITERATIONS = 150


def anonymous(traffic: Crossings, lags: Lags = NARROW) -> dict[str, Findings]:
    """Return three scores: probability of the transition, that over its noise, and highest rate.

    The noise is the standard error if the transitions were spurious; the rate is over all delays.
    """
    # Groups of delays, centred counts, and the least squares fit.
    zones = len(traffic.zones)
    groups = np.array([seconds for seconds in GROUPS if lags.low <= seconds <= lags.high])
    edges = groups / STEP_SECONDS
    exits, entries = _centred(traffic)
    exit_counts, entry_counts = (
        np.bincount(z, minlength=zones).astype(float)
        for z in (traffic.exit_zone, traffic.entry_zone)
    )
    rate = fit(exits, entries, edges.astype(np.int64), traffic.between)

    # Scores.
    share = (rate * np.diff(edges)[:, None, None]).sum(axis=0)
    noise = np.sqrt(np.maximum(entry_counts, 1.0)[None, :] / np.maximum(exit_counts, 1.0)[:, None])
    transit = (groups[1:] + groups[:-1])[rate.argmax(axis=0)] / 2
    return {
        "probability": Findings(share, transit),
        "over noise": Findings(share / noise, transit),
        "highest rate": Findings(
            (rate * np.sqrt(np.diff(edges))[:, None, None]).max(axis=0) / noise, transit
        ),
    }


def fit(
    exits: Floats, entries: Floats, edges: NDArray[np.int64], pair_mask: NDArray[np.bool_]
) -> Floats:
    """Estimate ``p_uv(d)`` per step for delays between ``edges`` (steps), (delays, zones, zones).

    exits, entries (steps, zones): centred counts. The method is non-negative least
    squares by accelerated projected gradient on the normal equations.
    """
    zones, n = exits.shape[1], len(edges) - 1
    # Sums of lagged products over the steps of two groups, from running sums over the lag.
    span = int(edges[-1] - edges[0])
    inner = {lag: _lagged(exits, exits, lag) for lag in range(-span, span + 1)}
    steps = [range(int(a), int(b)) for a, b in pairwise(edges)]
    gram = np.block([[_overlaps(inner, a, b) for b in steps] for a in steps])
    right = np.concatenate([sum(_lagged(exits, entries, d) for d in group) for group in steps])

    # Ridge, and scaling to a unit diagonal.
    gram[np.diag_indices_from(gram)] += RIDGE * gram.diagonal()
    scale = 1.0 / np.sqrt(np.maximum(gram.diagonal(), 1e-12))
    gram, right = gram * scale[:, None] * scale, right * scale[:, None]

    # Accelerated projected gradient.
    open_ = np.tile(pair_mask, (n, 1))
    step = 1.0 / _largest_eigenvalue(gram)
    now = ahead = np.zeros((n * zones, zones))
    momentum = 1.0
    for _ in range(ITERATIONS):
        new = np.where(open_, np.maximum(ahead - step * (gram @ ahead - right), 0.0), 0.0)
        faster = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = new + (momentum - 1) / faster * (new - now)
        now, momentum = new, faster
    result: Floats = (now * scale[:, None]).reshape(n, zones, zones)
    return result


def _overlaps(inner: dict[int, Floats], a: range, b: range) -> Floats:
    """Return ``sum_t a_u(t) b_v(t)`` of series summed over the delays of two groups."""
    times = Counter(i - j for i in a for j in b)
    return sum((n * inner[lag] for lag, n in times.items()), np.zeros_like(inner[0]))


def _centred(traffic: Crossings) -> tuple[Floats, Floats]:
    """Return exits and entries per step and zone, less their moving averages."""
    start = min(traffic.exits[0], traffic.entries[0])
    steps = int((max(traffic.exits[-1], traffic.entries[-1]) - start) / STEP_SECONDS) + 1
    result = []
    for t, zone in ((traffic.exits, traffic.exit_zone), (traffic.entries, traffic.entry_zone)):
        counts = np.zeros((steps, len(traffic.zones)))
        np.add.at(counts, (((t - start) / STEP_SECONDS).astype(np.int64), zone), 1.0)
        window = min(round(AVERAGE_SECONDS / STEP_SECONDS), steps)
        result.append(counts - uniform_filter1d(counts, window, axis=0, mode="reflect"))
    return result[0], result[1]


def _lagged(a: Floats, b: Floats, steps: int) -> Floats:
    """Return ``sum_t a_u(t - steps) b_v(t)``, (zones, zones)."""
    length = max(len(a) - abs(steps), 0)  # none of a recording shorter than the lag
    if steps >= 0:
        return a[:length].T @ b[len(b) - length :]
    return a[len(a) - length :].T @ b[:length]


def _largest_eigenvalue(matrix: Floats) -> float:
    """Return an upper bound of the largest eigenvalue, by power iteration."""
    vector = np.ones(len(matrix))
    for _ in range(30):
        vector = matrix @ vector
        vector /= np.linalg.norm(vector)
    return 1.05 * float(np.linalg.norm(matrix @ vector))
