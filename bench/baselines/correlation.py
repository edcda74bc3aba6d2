"""Cross-correlation of exits and entries.

Makris, Ellis, Black, "Bridging the gaps between cameras", CVPR 2004. Two zones are linked when the
correlation has a clear peak: it exceeds the mean over all lags by a number of standard deviations.
The lag of the peak is the transit time. The paper leaves the bin width open, so several are tried.
"""

from __future__ import annotations

import numpy as np

from bench.baselines.crossings import Candidates, Crossings, lag_counts
from bench.baselines.findings import Findings

WIDTHS = (1.0, 2.0, 4.0, 8.0)
"""Bin widths of the lags, seconds."""


def correlation(traffic: Crossings, candidates: Candidates) -> dict[str, Findings]:
    """Return the score (peak - mean) / standard deviation of each pair, by bin width."""
    result = {}
    for width in WIDTHS:
        counts, centres = lag_counts(traffic, candidates, width)
        spread = np.maximum(counts.std(axis=2), 1e-9)
        score = (counts.max(axis=2) - counts.mean(axis=2)) / spread
        score[counts.sum(axis=2) < 3] = -np.inf
        result[f"{width:g} s bins"] = Findings(score, centres[counts.argmax(axis=2)])
    return result
