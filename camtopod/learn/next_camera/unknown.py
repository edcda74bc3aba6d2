"""Estimate which part of the unexplained departures may appear again at an unknown camera.

A departure that no hazard explains need not be one of an object that leaves the site: traffic may
be too dense, or the transit times too spread, for a path to be found. So the question is twofold:

* How many are too many? Of all objects that leave a view, about ``1 / (1 + cameras / 4)`` leave the
  site: the larger the site, the fewer of its paths lead out. The surplus over that share may
  appear again.
* Could it be known? Had these objects gone on by one path, the fit would have gained evidence from
  it, more at zones with many departures and in light traffic. Where it would have been found, and
  was not, it is not there, and the objects leave.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from camtopod.arrays import Floats

LEAVING_CAMERAS = 4.0
"""Number of cameras of a site at which half of all departures leave it."""
SURE_MAX = 0.95
"""Largest share of the departures without explanation that are taken to leave."""
SPREAD_STEPS = 8
"""Number of spreads of transit times, from a second to the longest lag, that a path may have."""


def unknown_shares(
    departures: Floats, leave: Floats, rate: Floats, cameras: int, lag_max: float
) -> Floats:
    """Return the share (zones,) of the departures said to leave that may appear again.

    departures (zones,): number of departures of each zone.
    leave (zones,): share of them that is said to leave the site, spurious transitions included.
    rate (zones, 1/s): rate of arrivals at each zone that no departure explains.
    cameras: number of cameras.
    lag_max (seconds): longest lag.
    """
    gone = departures * leave
    if not gone.any() or not rate.any():
        return np.zeros(len(leave))

    # The surplus of leaving departures over the usual share at a site of this size.
    usual = float(departures.sum()) / (1.0 + cameras / LEAVING_CAMERAS)
    surplus = 1.0 - min(usual / float(gone.sum()), SURE_MAX)

    # The evidence of a path of all these departures, by the spread of its transit times: each
    # transition competes with the arrivals of a usual zone within the spread.
    spread = np.geomspace(1.0, lag_max, SPREAD_STEPS)
    chance = spread * (rate @ rate) / rate.sum()
    share = leave[:, None] / (leave[:, None] + np.maximum(chance, 1e-6))
    evidence = gone[:, None] * (-np.log1p(-share) - share)

    # The probability that it falls short of what tells a path from all others that are possible;
    # the variance of a log likelihood ratio is about twice its mean.
    needed = np.log(len(rate) * lag_max / spread)
    missed: Floats = ndtr((needed - evidence) / np.sqrt(2.0 * evidence + 1.0)).mean(axis=1)
    return surplus * missed
