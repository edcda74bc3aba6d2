"""Time windows from masses over lag bins, and the share of each bin that is still possible.

A time window says when an object probably appears at a zone: the 10 %, 50 % and 90 % quantiles of
the lag. As time passes without a matching arrival, lags that have passed are no longer possible
(`unknown_share`).
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats

WINDOW = (0.1, 0.5, 0.9)
"""Quantiles of the lag at which a time window has its beginning, median and end."""


def scale_lags(lags: Floats, factor: float) -> Floats:
    """Return lags (n, seconds) times a factor, except for lags before the exit.

    factor: expected transit time of an object over the usual one; lags before the exit do not scale
        with speed.
    """
    return lags if factor == 1.0 else np.where(lags > 0, factor * lags, lags)


def unknown_share(edges: Floats, elapsed: float, remembered: float, shift: Floats) -> Floats:
    """Return the share of each lag bin in which an arrival would not be known, (targets, bins).

    edges (bins + 1, seconds): edges of the lag bins.
    elapsed: seconds since the exit.
    remembered: time, in seconds after the exit, since which all arrivals are remembered.
    shift (targets, seconds): to be added to a lag to get the seconds from the exit to the report of
        the arrival.

    An arrival would not be known if it is still to come, or if it was reported after the exit and
    is no longer remembered.
    """
    # Bounds in lags of each target; those before the exit do not matter.
    by_target = shift[:, None]
    low = np.maximum(edges[:-1], -by_target)
    high = edges[1:]
    now = elapsed - by_target
    memory = remembered - by_target

    # Seconds of each bin that are still to come, and that are forgotten.
    coming = np.maximum(high - np.maximum(low, now), 0.0)
    forgotten = np.maximum(np.minimum(high, np.minimum(memory, now)) - low, 0.0)
    share: Floats = (coming + forgotten) / np.diff(edges)
    return share


def quantiles(mass: Floats, edges: Floats) -> Floats:
    """Return the lags below which the shares `WINDOW` of each target's mass lie, (targets, 3).

    mass (targets, bins): mass of each lag bin; the sum of each row is above 0.
    edges (bins + 1, seconds): edges of the lag bins.

    Within a bin, the mass is taken as uniform.
    """
    # Mass below each edge, and the mass to be reached.
    below = np.cumsum(np.pad(mass, ((0, 0), (1, 0))), axis=1)
    wanted = np.array(WINDOW) * below[:, -1:]

    # Bin in which that mass is reached.
    row = np.arange(len(mass))[:, None]
    at = np.argmax(below[:, None, :] > wanted[:, :, None], axis=2) - 1

    # Interpolate within the bin.
    seconds_per_mass = (edges[at + 1] - edges[at]) / (below[row, at + 1] - below[row, at])
    lags: Floats = edges[at] + seconds_per_mass * (wanted - below[row, at])
    return lags
