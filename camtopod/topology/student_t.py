"""Student's t distribution with 5 degrees of freedom, that of the lags of a path."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats

DEGREES = 5.0
"""Degrees of freedom: tails heavier than those of a normal distribution."""
WIDTH_MIN = 1e-3
"""Least scale of the shares of a distribution, seconds."""
REACH_WIDTHS = 5.0
"""Lags farther than this many widths from the place of a path do not belong to it."""


def student_density(x: Floats, place: Floats, width: Floats) -> Floats:
    """Return the density (n,) at ``x``, of distributions with medians and scales of shape (n,)."""
    z = (x - place) / width
    density: Floats = 8.0 / (3.0 * np.sqrt(5.0) * np.pi) / width / (1.0 + z * z / DEGREES) ** 3
    return density


def student_share(x: Floats, place: float | Floats, width: float | Floats) -> Floats:
    """Return the probability (n,) of values below ``x`` (n,), in closed form.

    place, width: median and scale, or columns (K, 1) of them; then the result is (K, n). A scale
        below `WIDTH_MIN` counts as that.
    """
    angle = np.arctan((x - place) / np.maximum(width, WIDTH_MIN) / np.sqrt(DEGREES))
    sines = np.sin(angle) * np.cos(angle) * (1.0 + 2.0 / 3.0 * np.cos(angle) ** 2)
    share: Floats = 0.5 + (angle + sines) / np.pi
    return share
