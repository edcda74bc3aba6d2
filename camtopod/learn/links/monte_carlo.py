"""Monte Carlo observations of a link (thesis 4.3, table 4.2): more transit times than were seen.

The thesis adds random displacements to observed values, N = 8 sigma / epsilon times (eq. 4.1), and
never rejects one, so its samples drift away from the data. Here a displacement is accepted by the
Metropolis rule on the link's transit density, which makes that density the stationary distribution
of the walk.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats
from camtopod.topology import LagBins

OBSERVATIONS = 89
"""Observations per link, as in the thesis's experiment 1."""
EPSILON_SECONDS = 0.0134
"""Precision asked for, seconds; sigma = 0.5828 then takes the 348 iterations of section 5.1."""
ITERATIONS_MAX = 64
"""Limit of the iterations.

The walk starts from lags that already have the distribution wanted, so it need not run long.
"""


def iterations_needed(sigma: float, epsilon: float = EPSILON_SECONDS) -> int:
    """Return N = 8 sigma / epsilon (eq. 4.1), rounded up."""
    return int(np.ceil(round(8.0 * sigma / epsilon, 6)))


def observe(density: Floats, sigma: Floats, bins: LagBins, seed: int) -> Floats:
    """Return Monte Carlo transit times (L, `OBSERVATIONS`) in seconds of L links.

    density (L, bins): transit density per second.
    sigma (L, seconds): standard deviation of the displacements.
    """
    # Start from the quantiles of the density, evenly within their bins.
    links = len(density)
    random = np.random.Generator(np.random.Philox(key=seed))
    mass = density * bins.widths
    reached = np.cumsum(mass, axis=1) / np.maximum(mass.sum(axis=1, keepdims=True), 1e-300)
    level = (np.arange(OBSERVATIONS) + 0.5) / OBSERVATIONS
    at = (
        np.stack([np.searchsorted(row, level) for row in reached])
        if links
        else np.zeros((0, OBSERVATIONS), int)
    )
    at = np.minimum(at, bins.size - 1)
    lag: Floats = bins.edges[at] + random.random((links, OBSERVATIONS)) * bins.widths[at]

    # Metropolis walk: accept a displacement with the ratio of the densities as probability.
    here = np.take_along_axis(density, at, axis=1)
    for _ in range(min(iterations_needed(float(sigma.max(initial=0.0))), ITERATIONS_MAX)):
        moved = lag + random.normal(size=lag.shape) * sigma[:, None]
        to = bins.index(moved)
        there = np.where(to >= 0, np.take_along_axis(density, np.maximum(to, 0), axis=1), 0.0)
        accept = random.random(lag.shape) * here < there
        lag = np.where(accept, moved, lag)
        here = np.where(accept, there, here)
    return lag
