"""Odds over lag bins: what is left of them as time passes, at whose pace, and the windows they
make.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from camtopod.arrays import Floats

WINDOW = (0.1, 0.5, 0.9)
"""The shares of the mass at whose lags a window begins, has its middle and ends."""


def paced(lag: Floats, slower: float) -> Floats:
    """Lags of somebody who takes ``slower`` times as long; those before the exit do not go by
    it.
    """
    return np.where(lag > 0, slower * lag, lag)


def unknown(edges: Floats, elapsed: float, remembered: float, later: Floats) -> Floats:
    """Share of each bin, (targets, bins), of lags at which an arrival would not be known
    ``elapsed`` seconds after an exit: those still to come, and those after the exit of which what
    came is not ``remembered``, from so many seconds after it on. ``later``: by how much the
    targets' clocks are ahead, (targets,).
    """
    shift = later[:, None]
    low, high, until = np.maximum(edges[:-1], -shift), edges[1:], elapsed - shift
    coming = np.maximum(high - np.maximum(low, until), 0.0)
    forgotten = np.maximum(np.minimum(high, np.minimum(remembered - shift, until)) - low, 0.0)
    share: Floats = (coming + forgotten) / np.diff(edges)
    return share


def quantiles(mass: Floats, edges: Floats) -> list[list[float]]:
    """Lags (targets, 3) below which there are the shares `WINDOW` of the mass (targets, bins)
    between ``edges``; in between as `np.interp` has it.
    """
    rows = np.arange(len(mass))[:, None]
    reached = np.zeros((len(mass), len(edges)))
    np.cumsum(mass, axis=1, out=reached[:, 1:])
    wanted = np.array(WINDOW) * reached[:, -1:]
    k = np.minimum((reached[:, None, :] <= wanted[:, :, None]).sum(axis=2) - 1, len(edges) - 2)
    below = reached[rows, k]
    slope = (edges[k + 1] - edges[k]) / (reached[rows, k + 1] - below)
    lags: list[list[float]] = (slope * (wanted - below) + edges[k]).tolist()
    return lags


def quantiles_beside(
    coming: Sequence[float], share: float, came: Sequence[tuple[int, float]], edges: Sequence[float]
) -> list[float]:
    """`quantiles` of one target, of whose mass there is ``coming`` (bins + 1,) below each edge,
    ``share`` times, and what ``came`` beside that: (bin, mass), by bin.
    """
    last, passed, low, beside = (
        len(coming) - 2,
        0,
        0,
        0.0,
    )  # what one quantile is behind, the later ones are, too
    total = share * coming[last + 1] + sum(mass for _, mass in came)
    lags = []
    for part in WINDOW:
        wanted, first, high, here = part * total, low, last, 0.0
        while passed < len(came):
            at, mass = came[passed]
            if share * coming[at] + beside > wanted:  # below this bin
                high = at - 1
                break
            if share * coming[at + 1] + beside + mass > wanted:  # in it
                first, high, here = at, at, mass
                break
            first, low, beside, passed = at + 1, at + 1, beside + mass, passed + 1
        k = min(max(bisect_right(coming, (wanted - beside) / share) - 1, first), high)
        gap = share * (coming[k + 1] - coming[k]) + here
        within = (
            (wanted - (share * coming[k] + beside)) / gap if gap > 0.0 else 0.0
        )  # nothing there: by rounding
        lags.append(edges[k] + min(max(within, 0.0), 1.0) * (edges[k + 1] - edges[k]))
    return lags
