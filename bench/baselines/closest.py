"""The thesis's own test for links: Mahalanobis distances of closest pairs, linked if Var(d) <= 1.

Alkhateeb 2011, table 4.3. The thesis estimates S in the distance from the times of the two zones
themselves (eq. 4.4), against which no difference is large. The other variants scale in the test's
favour: S is the spread of the closest pairs of two unrelated Poisson processes.
"""

from __future__ import annotations

import numpy as np

from bench.baselines.crossings import Crossings
from bench.baselines.findings import Findings
from camtopod.arrays import Floats

LITERAL = "as printed"
"""Name of the variant with S as the thesis prints it."""
LITERAL_SCORE_MIN = -1.0
"""Least score of a link in the variant `LITERAL`: the score is -Var(d), and links have Var(d) <= 1.
"""
MODE_BINS = 40
"""Bins of the histogram of lags from which the transit time is read."""


def closest(traffic: Crossings) -> dict[str, Findings]:
    """Return the score -Var(d) of each pair, in three variants.

    They are `LITERAL`, and two scaled by the null model of unrelated Poisson processes: with the
    closest arrival before or after, and with the first arrival after.
    """
    zones = len(traffic.zones)
    names = (LITERAL, "closest, null model", "first after, null model")
    result = {
        name: Findings(np.full((zones, zones), -np.inf), np.full((zones, zones), np.nan))
        for name in names
    }
    seconds = (
        float(
            max(traffic.exits[-1], traffic.entries[-1]) - min(traffic.exits[0], traffic.entries[0])
        )
        if len(traffic.exits)
        else 0.0
    )

    # Times of each zone, then the distances of each pair of zones.
    exits = [traffic.exits[traffic.exit_zone == k] for k in range(zones)]
    entries = [traffic.entries[traffic.entry_zone == k] for k in range(zones)]
    for u, v in np.argwhere(traffic.between):
        if len(exits[u]) < 3 or len(entries[v]) < 3:
            continue
        rate = len(entries[v]) / seconds
        near = _nearest(exits[u], entries[v])
        lag = near - exits[u]
        after = (
            entries[v][np.minimum(np.searchsorted(entries[v], exits[u]), len(entries[v]) - 1)]
            - exits[u]
        )
        after = after[after > 0]
        common = abs(float(np.cov(exits[u], near)[0, 1]))
        result[names[0]].score[u, v] = -float(np.var(lag**2 / max(common, 1e-9)))
        result[names[1]].score[u, v] = -float(np.var(lag) * 2 * rate**2)
        result[names[0]].transit[u, v] = result[names[1]].transit[u, v] = _mode(lag)
        if len(after) >= 3:
            result[names[2]].score[u, v] = -float(np.var(after) * rate**2)
            result[names[2]].transit[u, v] = _mode(after)
    return result


def _nearest(exits: Floats, entries: Floats) -> Floats:
    """Return the time of the nearest entry for each exit, seconds."""
    after = np.clip(np.searchsorted(entries, exits), 1, len(entries) - 1)
    near: Floats = np.where(
        entries[after] - exits < exits - entries[after - 1], entries[after], entries[after - 1]
    )
    return near


def _mode(lags: Floats) -> float:
    """Return the centre of the fullest histogram bin (thesis 4.5) in the middle 90 % of lags."""
    low, high = np.quantile(lags, (0.05, 0.95))
    if high <= low:
        return float(low)
    counts, edges = np.histogram(lags, MODE_BINS, (low, high))
    k = int(np.argmax(counts))
    return float(edges[k : k + 2].mean())
