"""A multivariate Hawkes process: every exit raises the rate of entries elsewhere for a while.

Fitted by EM with histogram kernels and a background rate that changes over the day (Lewis and
Mohler, "A nonparametric EM algorithm for multiscale Hawkes processes", 2011). The model explains
indirect links away, but allows an exit to cause any number of entries. Kernels may extend to
negative lags, for overlapping views.
"""

from __future__ import annotations

import numpy as np

from bench.baselines.crossings import Candidates, Crossings, smoother
from bench.baselines.findings import Findings

ITERATIONS = 40
SCALE_SECONDS, STEP = 4.0, 0.2
"""Scale of the lag bins, seconds, and their width: bins are uniform in asinh(lag / scale)."""
SMOOTHING_SD_BINS = 1.5
"""Standard deviation of the kernels' smoothing, in bins."""
BACKGROUND_SECONDS = 900.0
"""Length of the blocks in which the background rate is constant, seconds."""


def hawkes(traffic: Crossings, candidates: Candidates) -> dict[str, Findings]:
    """Return two scores of each pair: entries caused per exit, and log
    likelihood gain (nats).
    """
    (low, high), zones = candidates.lags, len(traffic.zones)

    # Bins of lags, and the bin of each candidate.
    first = int(np.floor(np.arcsinh(low / SCALE_SECONDS) / STEP))
    edges = SCALE_SECONDS * np.sinh(
        STEP * np.arange(first, np.arcsinh(high / SCALE_SECONDS) / STEP + 1)
    )
    edges[0], edges[-1] = low, high
    bins, widths = len(edges) - 1, np.diff(edges)
    at = np.clip(np.searchsorted(edges, candidates.lag, side="right") - 1, 0, bins - 1)
    key = (candidates.pair * bins + at).astype(np.int32)

    # Candidates by arrival; the block and zone of each arrival's background.
    entries = np.unique(candidates.arrival)
    arrival = np.searchsorted(entries, candidates.arrival)
    starts = (
        np.flatnonzero(np.r_[True, arrival[1:] != arrival[:-1]])
        if len(arrival)
        else np.zeros(0, np.int64)
    )
    block = ((traffic.entries[entries] - traffic.entries[0]) / BACKGROUND_SECONDS).astype(
        np.int64
    ) * zones + traffic.entry_zone[entries]

    # Initial kernels and background; exposure of each bin.
    exposure = (
        np.repeat(np.maximum(np.bincount(traffic.exit_zone, minlength=zones), 1), zones)[:, None]
        * widths
    )
    rate = np.full((zones * zones, bins), 0.5 / zones / (high - low))
    background = np.bincount(block) * 0.5 / BACKGROUND_SECONDS
    mass = np.zeros_like(rate)
    spread = smoother(bins, SMOOTHING_SD_BINS)
    share = np.zeros(len(key))

    # EM: share of each cause of an arrival, then kernels and background.
    for _ in range(ITERATIONS):
        density = rate.ravel()[key]
        outside = background[block]
        total = outside + (np.add.reduceat(density, starts) if len(starts) else 0.0)
        share = density / total[arrival]
        mass = np.bincount(key, share, minlength=rate.size).reshape(rate.shape)
        rate = mass @ spread / exposure
        background = np.bincount(block, outside / total) / BACKGROUND_SECONDS

    # Scores, and the median lag of each kernel.
    caused = mass.sum(axis=1)
    gain = (
        np.bincount(
            candidates.pair, -np.log1p(-np.minimum(share, 1 - 1e-9)), minlength=zones * zones
        )
        - caused
    )
    exit_counts = np.maximum(np.bincount(traffic.exit_zone, minlength=zones), 1)[:, None]
    cumulative = np.cumsum(mass, axis=1)
    middle = (cumulative >= cumulative[:, -1:] / 2).argmax(axis=1)
    transit = ((edges[1:] + edges[:-1]) / 2)[middle].reshape(zones, zones)
    caused = caused.reshape(zones, zones)
    return {
        "per departure": Findings(caused / exit_counts, transit),
        "likelihood": Findings(gain.reshape(zones, zones), transit),
    }
