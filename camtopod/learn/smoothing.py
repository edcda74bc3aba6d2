"""Histograms of lags smoothed: the fewer transitions, the wider."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.candidates import rows_together
from camtopod.learn.lags import smoother

Floats = NDArray[np.float64]

SMOOTHING_SD_BINS = ((50.0, 1.2), (12.0, 1.8), (0.0, 2.8))
"""(at least this many expected transitions, smooth by this many bins)."""


def smooth(counts: Floats, total: Floats | None = None) -> tuple[Floats, Floats]:
    """Counts (P, bins) spread over neighbouring bins, the wider the fewer there are, or as for a ``total`` (P,) of
    them; and the share (P,) that stays.
    """
    size = counts.shape[1]
    total = counts.sum(axis=1) if total is None else total
    result = np.zeros_like(counts)
    stays = np.zeros(len(total))
    above = np.full(len(total), False)
    for least, sd_bins in SMOOTHING_SD_BINS:
        few = np.flatnonzero((total >= least) & ~above)
        above[few] = True
        spread = smoother(size, sd_bins)
        for part in rows_together(len(few)):
            rows = few[part]
            result[rows] = counts[rows] @ spread.T
            stays[rows] = spread[size // 2, size // 2]
    return result, stays
