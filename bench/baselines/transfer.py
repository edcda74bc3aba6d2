"""Transfer entropy at many delays (Ito et al., "Extending transfer entropy", PLoS ONE 6(11), 2011).

Exits and entries are binary series. The transfer at delay d is the information that an
exit d ago gives on an entry now beyond the series of entries itself: ``I(y_t; x_{t-d} |
y_{t-1})``. A link shows as a high peak over the delays, or as a high coincidence index: the share
of the summed transfer that lies around the peak. Negative delays, for overlapping views, are no
transfer in the paper's sense, but without them the method would miss those links.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from bench.baselines.crossings import NARROW, Crossings, Lags
from bench.baselines.findings import Findings
from camtopod.arrays import Floats

WIDTHS = (2.0, 4.0, 8.0)
"""Bin widths of the series, seconds."""
AROUND_SECONDS = 8.0
"""Width of the surroundings of the peak in the coincidence index, seconds."""


def transfer(traffic: Crossings, lags: Lags = NARROW) -> dict[str, Findings]:
    """Return the peak, the coincidence index and their product for each bin width."""
    result = {}
    for width in WIDTHS:
        entropy, delays = by_delay(traffic, width, lags)
        peak = entropy.argmax(axis=0)
        half = round(AROUND_SECONDS / width / 2)
        near = np.abs(np.arange(len(delays))[:, None, None] - peak[None]) <= half
        index = (entropy * near).sum(axis=0) / np.maximum(entropy.sum(axis=0), 1e-12)
        transit = delays[peak]
        result[f"peak, {width:g} s bins"] = Findings(entropy.max(axis=0), transit)
        result[f"coincidence index, {width:g} s bins"] = Findings(index, transit)
        result[f"peak x index, {width:g} s bins"] = Findings(entropy.max(axis=0) * index, transit)
    return result


def by_delay(traffic: Crossings, width: float, lags: Lags = NARROW) -> tuple[Floats, Floats]:
    """Return the transfer entropy, bits, (delays, zones, zones), and the delays, seconds."""
    # Series of exits (x) and entries (y), and their marginal counts.
    zones = len(traffic.zones)
    start = min(traffic.exits[0], traffic.entries[0])
    bins = int((max(traffic.exits[-1], traffic.entries[-1]) - start) / width) + 2
    x = _series(traffic.exits - start, traffic.exit_zone, width, bins, zones)
    y = _series(traffic.entries - start, traffic.entry_zone, width, bins, zones)
    before = _shift(y, 1)
    repeats = y.multiply(before).tocsr()
    leaves = np.asarray(x.sum(axis=0)).ravel()[:, None]
    of_y, of_both = (np.asarray(m.sum(axis=0)).ravel()[None, :] for m in (y, repeats))

    # Joint counts at each delay.
    steps = np.arange(round(lags.low / width), round(lags.high / width) + 1)
    result: list[Floats] = []
    for step in steps:
        late = _shift(x, int(step)).T
        now, then, twice = ((late @ m).toarray() for m in (y, before, repeats))
        # Counts with x = 1, then with any x, by (y now, y before).
        joint = (twice, now - twice, then - twice, leaves - now - then + twice)
        total = (of_both, of_y - of_both, of_y - of_both, bins - 2 * of_y + of_both)
        result.append(_bits(joint, total) / bins)
    return np.array(result), (steps * width).astype(np.float64)


def _series(t: Floats, zone: NDArray[np.int64], width: float, bins: int, zones: int) -> csr_matrix:
    """Return a series of 0 and 1, (bins, zones): 1 where at least one event happened."""
    series = csr_matrix(
        (np.ones(len(t)), ((t / width).astype(np.int64), zone)), shape=(bins, zones)
    )
    series.data[:] = 1.0
    return series


def _shift(series: csr_matrix, steps: int) -> csr_matrix:
    """Return the series ``steps`` bins later, cut to the same length."""
    coo = series.tocoo()
    row = coo.row + steps
    inside = (row >= 0) & (row < series.shape[0])
    return csr_matrix((coo.data[inside], (row[inside], coo.col[inside])), shape=series.shape)


def _bits(joint: tuple[Floats, ...], total: tuple[Floats, ...]) -> Floats:
    """Return the sum over outcomes of count * log2 of p(y | before, x) / p(y | before)."""
    result = np.zeros_like(joint[0])
    for with_x in (True, False):
        n = [j if with_x else t - j for j, t in zip(joint, total, strict=True)]
        for now, alternative in (
            (0, 2),
            (2, 0),
            (1, 3),
            (3, 1),
        ):  # outcomes 0 and 2 share y before = 1
            given_x = n[now] / np.maximum(n[now] + n[alternative], 1e-12)
            share = total[now] / np.maximum(total[now] + total[alternative], 1e-12)
            ratio = np.maximum(given_x, 1e-300) / np.maximum(share, 1e-300)
            result += np.where(n[now] > 0, n[now] * np.log2(ratio), 0.0)
    return np.maximum(result, 0.0)
