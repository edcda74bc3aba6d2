"""Is there a valley between two groups of events? A test that needs no shape.

A single zone may have any shape with one hump; two zones have a dip between them. Along the line that tells
the groups best apart, the events in a stretch (the valley) are compared with those in a stretch on either
side (the flanks): the log likelihood ratio of two Poisson rates against one, maximised over stretches. Its
smaller side counts, for one hump needs only one of them filled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Floats = NDArray[np.float64]

DEPTH = 0.85
"""A valley is at most so dense in terms of its flanks; shallower ones are ripples, whatever their
significance."""
_STEPS = 18
"""Grid points along the line."""
_STEP = np.arange(_STEPS)
_WIDTH = np.maximum(_STEP - _STEP[:, None], 1)
_INNER = [(low, high) for low in range(1, _STEPS - 2) for high in range(low + 1, _STEPS - 1)]
"""Stretches that may be a valley: there is something on either side. Below, each with each of its flanks to the left,
then each with each to the right, by the flat index (from, to) of the valley, of the flank, and of both together."""
_VALLEYS, _FLANKS, _WHOLES = np.array(
    [
        *[(b * _STEPS + c, a * _STEPS + b, a * _STEPS + c) for b, c in _INNER for a in range(b)],
        *[(b * _STEPS + c, c * _STEPS + d, b * _STEPS + d) for b, c in _INNER for d in range(c + 1, _STEPS)],
    ]
).T.copy()
_STARTS = np.flatnonzero(np.diff(_VALLEYS, prepend=-1))
_ONE_SIDE = len(_INNER)


def valley(n: Floats, position: Floats, sd: Floats, low: float, high: float) -> float:
    """Log likelihood ratio for a valley somewhere in [low, high].

    ``n`` events each (m,) at ``position`` (m,) along the line with spread ``sd`` (m,).
    """
    grid = low + (high - low) / (_STEPS - 1) * _STEP
    below = ndtr((grid[:, None] - position) / sd) @ n
    inside = np.maximum(below - below[:, None], 1e-9)
    rate = inside / _WIDTH
    own = (inside * np.log(rate)).ravel()
    ratio = own[_VALLEYS] + own[_FLANKS] - own[_WHOLES]
    rate = rate.ravel()
    # One that is not clearly less dense than its flank is no valley.
    ratio *= rate[_VALLEYS] < DEPTH * rate[_FLANKS]
    best = np.maximum.reduceat(ratio, _STARTS)
    return max(float(np.minimum(best[:_ONE_SIDE], best[_ONE_SIDE:]).max()), 0.0)
