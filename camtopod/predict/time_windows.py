"""Masses over lag bins: the share still possible as time passes, and the windows they make."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats

WINDOW = (0.1, 0.5, 0.9)
"""Shares of the mass at whose lags a window has its beginning, median and end."""


def scale_lags(lags: Floats, factor: float) -> Floats:
    """Return lags (seconds) times a factor; lags before the exit do not scale with speed."""
    return lags if factor == 1.0 else np.where(lags > 0, factor * lags, lags)


def unknown_share(edges: Floats, elapsed: float, remembered: float, shift: Floats) -> Floats:
    """Return the share (targets, bins) of each bin at whose lags an arrival would not be known.

    Those are lags after ``elapsed``, and lags after the exit that are no longer remembered.

    edges (bins + 1, seconds): edges of the lag bins.
    elapsed: seconds since the exit.
    remembered: seconds after the exit from which on arrivals are remembered.
    shift (targets, seconds): added to lags to get the time at which arrivals are reported.
    """
    # Bounds in lags of each target; those before the exit do not matter.
    by_target = shift[:, None]
    low, high = np.maximum(edges[:-1], -by_target), edges[1:]
    now, memory = elapsed - by_target, remembered - by_target

    # Seconds of each bin that are still to come, and that are forgotten.
    coming = np.maximum(high - np.maximum(low, now), 0.0)
    forgotten = np.maximum(np.minimum(high, np.minimum(memory, now)) - low, 0.0)
    share: Floats = (coming + forgotten) / np.diff(edges)
    return share


def quantiles(mass: Floats, edges: Floats) -> Floats:
    """Return the lags (targets, 3) below which the shares `WINDOW` of the mass lie.

    Within a bin the mass is taken as uniform, as in `np.interp`.

    mass (targets, bins): each row with a sum above 0.
    edges (bins + 1, seconds): edges of the lag bins.
    """
    # Mass below each edge, and the mass to be reached.
    below = np.zeros((len(mass), len(edges)))
    np.cumsum(mass, axis=1, out=below[:, 1:])
    wanted = np.array(WINDOW) * below[:, -1:]

    # Bin in which it is reached.
    row = np.arange(len(mass))[:, None]
    at = np.argmax(below[:, None, :] > wanted[:, :, None], axis=2) - 1

    # Interpolate within the bin.
    seconds_per_mass = (edges[at + 1] - edges[at]) / (below[row, at + 1] - below[row, at])
    lags: Floats = edges[at] + seconds_per_mass * (wanted - below[row, at])
    return lags
