"""The thesis's own test (Alkhateeb 2011, table 4.3): Mahalanobis distances of closest pairs, linked
when Var(d) <= 1.

The thesis takes S in the distance from the two zones' times themselves (eq. 4.4), against which no
difference is large. The other scalings are kinder to it: S from how far apart the closest of two
unrelated Poisson processes lie.
"""

from __future__ import annotations

import numpy as np

from bench.baselines.crossings import Crossings
from bench.baselines.findings import Findings
from camtopod.arrays import Floats

LITERAL = "as printed"
LITERAL_SCORE_MIN = -1.0
"""`LITERAL` links a pair when Var(d) <= 1; the score is -Var(d)."""
MODE_BINS = 40


def closest(seen: Crossings) -> dict[str, Findings]:
    """Score -Var(d): `LITERAL`, and against chance for the closest arrival on either side and the
    first one after.
    """
    zones = len(seen.zones)
    names = (LITERAL, "closest, against chance", "first after, against chance")
    result = {
        name: Findings(np.full((zones, zones), -np.inf), np.full((zones, zones), np.nan))
        for name in names
    }
    seconds = (
        float(max(seen.left[-1], seen.came[-1]) - min(seen.left[0], seen.came[0]))
        if len(seen.left)
        else 0.0
    )
    left = [seen.left[seen.left_zone == k] for k in range(zones)]
    came = [seen.came[seen.came_zone == k] for k in range(zones)]
    for u, v in np.argwhere(seen.between):
        if len(left[u]) < 3 or len(came[v]) < 3:
            continue
        rate = len(came[v]) / seconds
        near = _nearest(left[u], came[v])
        lag = near - left[u]
        after = came[v][np.minimum(np.searchsorted(came[v], left[u]), len(came[v]) - 1)] - left[u]
        after = after[after > 0]
        common = abs(float(np.cov(left[u], near)[0, 1]))
        result[names[0]].score[u, v] = -float(np.var(lag**2 / max(common, 1e-9)))
        result[names[1]].score[u, v] = -float(np.var(lag) * 2 * rate**2)
        result[names[0]].transit[u, v] = result[names[1]].transit[u, v] = _mode(lag)
        if len(after) >= 3:
            result[names[2]].score[u, v] = -float(np.var(after) * rate**2)
            result[names[2]].transit[u, v] = _mode(after)
    return result


def _nearest(left: Floats, came: Floats) -> Floats:
    """For each time of ``left`` the nearest of ``came``."""
    after = np.clip(np.searchsorted(came, left), 1, len(came) - 1)
    near: Floats = np.where(
        came[after] - left < left - came[after - 1], came[after], came[after - 1]
    )
    return near


def _mode(lags: Floats) -> float:
    """Centre of the fullest histogram bin (thesis 4.5), within the middle 90 % of the
    differences.
    """
    low, high = np.quantile(lags, (0.05, 0.95))
    if high <= low:
        return float(low)
    counts, edges = np.histogram(lags, MODE_BINS, (low, high))
    k = int(np.argmax(counts))
    return float(edges[k : k + 2].mean())
