"""Monte Carlo observations of links (thesis 4.3, table 4.2): more transit times than were observed.

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
ITERATIONS = 64
"""Iterations of the walk. It starts from lags that already have the stationary distribution, so it
need not run as long as eq. 4.1 asks.
"""


def observe(density: Floats, sigma: Floats, bins: LagBins, seed: int) -> Floats:
    """Return `OBSERVATIONS` Monte Carlo transit times, in seconds, of each of L links, (L, n).

    density (L, bins): density of each link's transit times, per second.
    sigma (L, seconds): standard deviation of the displacements, that of the transit times.
    seed: of the random numbers.
    """
    # Start from the quantiles of the density, evenly within their bins.
    links = len(density)
    random = np.random.Generator(np.random.Philox(key=seed))
    mass = density * bins.widths
    cumulative = np.cumsum(mass, axis=1) / np.maximum(mass.sum(axis=1, keepdims=True), 1e-300)
    level = (np.arange(OBSERVATIONS) + 0.5) / OBSERVATIONS
    quantile = np.array([np.searchsorted(row, level) for row in cumulative], int)
    at = np.minimum(quantile.reshape(links, OBSERVATIONS), bins.size - 1)
    lag: Floats = bins.edges[at] + random.random((links, OBSERVATIONS)) * bins.widths[at]

    # Metropolis walk: accept a displacement with the ratio of the densities as probability.
    density_here = np.take_along_axis(density, at, axis=1)
    for _ in range(ITERATIONS):
        proposal = lag + random.normal(size=lag.shape) * sigma[:, None]
        to = bins.index(proposal)
        density_moved = np.where(
            to >= 0, np.take_along_axis(density, np.maximum(to, 0), axis=1), 0.0
        )
        accept = random.random(lag.shape) * density_here < density_moved
        lag = np.where(accept, proposal, lag)
        density_here = np.where(accept, density_moved, density_here)
    return lag
