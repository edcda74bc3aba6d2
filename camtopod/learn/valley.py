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
_A, _B, _C = (index.ravel() for index in np.meshgrid(*[np.arange(_STEPS)] * 3, indexing="ij"))
_TRIPLES = (_A < _B) & (_B < _C)
_A, _B, _C = _A[_TRIPLES], _B[_TRIPLES], _C[_TRIPLES]
_PAIR_AB, _PAIR_BC = _A * _STEPS + _B, _B * _STEPS + _C
_BY_BC = np.lexsort((_A, _PAIR_BC))
_STARTS_AB = np.flatnonzero(np.diff(_PAIR_AB, prepend=-1))
_STARTS_BC = np.flatnonzero(np.diff(_PAIR_BC[_BY_BC], prepend=-1))


def valley(n: Floats, position: Floats, sd: Floats, low: float, high: float) -> float:
    """Log likelihood ratio for a valley somewhere in [low, high].

    ``n`` events each (m,) at ``position`` (m,) along the line with spread ``sd`` (m,).
    """
    grid = np.linspace(low, high, _STEPS)
    below = (n * ndtr((grid[:, None] - position) / sd)).sum(axis=1)
    near, far = below[_B] - below[_A], below[_C] - below[_B]
    width_near, width_far = _B - _A, _C - _B
    left = np.full(_STEPS * _STEPS, 0.0)
    right = np.full(_STEPS * _STEPS, 0.0)
    # The flank is a..b and the valley b..c, and the other way round.
    in_far, in_near = _log_ratios(far, width_far, near, width_near)
    left[_PAIR_BC[_BY_BC][_STARTS_BC]] = np.maximum.reduceat(in_far[_BY_BC], _STARTS_BC)
    right[_PAIR_AB[_STARTS_AB]] = np.maximum.reduceat(in_near, _STARTS_AB)
    return float(np.minimum(left, right).max())


def _log_ratios(a: Floats, width_a: NDArray[np.intp], b: Floats, width_b: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Two Poisson rates against one, for a valley in ``a`` and for one in ``b``; 0 where the valley is not clearly less
    dense than its flank."""
    a, b = np.maximum(a, 1e-9), np.maximum(b, 1e-9)
    rate_a, rate_b = a / width_a, b / width_b
    together = (a + b) / (width_a + width_b)
    ratio: Floats = a * np.log(rate_a / together) + b * np.log(rate_b / together)
    return np.where(rate_a < DEPTH * rate_b, ratio, 0.0), np.where(rate_b < DEPTH * rate_a, ratio, 0.0)
