"""Expected height of a person by row of the image: a line fitted to people seen so far."""

from __future__ import annotations

from collections import deque

import numpy as np

SAMPLES_MAX = 400
"""Samples kept, the newest: of heights, and of unexplained beginnings and ends (`doors`)."""
SAMPLES_MIN = 20
"""Samples needed for a fit."""
OBJECTS_MIN = 2
"""Objects needed for a fit: one object does not tell the height of others."""
OUTLIER_FACTOR = 2.5
"""Factor of the median, of a residual or of a height, beyond which it is not believed."""


class Stature:
    """Line height = a + b * foot row, fitted robustly to whole, confirmed, single objects."""

    def __init__(self) -> None:
        self._new = False
        self._samples: deque[tuple[int, float, float]] = deque(maxlen=SAMPLES_MAX)
        self._line: tuple[float, float] | None = None
        self._middle = 0.0

    def add(self, track: int, foot_y: float, height: float) -> None:
        """Add a sighting of ``track``: feet in row ``foot_y``, height in pixels."""
        self._samples.append((track, foot_y, height))
        self._new = True

    def _fit(self) -> None:
        """Fit the line in three rounds, each without the outliers of the one before.

        The slope is 0 unless the rows span more than a person's height.
        """
        self._new = False
        objects = {number for number, _, _ in self._samples}
        if len(self._samples) < SAMPLES_MIN or len(objects) < OBJECTS_MIN:
            return
        _, rows, heights = np.array(self._samples).T
        self._middle = float(np.median(heights))
        mask = np.ones(len(rows), bool)
        slope = 0.0
        base = self._middle
        for _ in range(3):
            if np.ptp(rows[mask]) > self._middle:
                x, y = rows[mask], heights[mask]
                from_middle = x - x.mean()
                slope = float(from_middle @ y / (from_middle @ from_middle))
                base = float(y.mean() - slope * x.mean())
            residual = np.abs(heights - (base + slope * rows))
            mask = residual <= OUTLIER_FACTOR * np.median(residual) + 1e-9
        self._line = (base, slope)

    def height(self, foot_y: float) -> float | None:
        """Return the expected height in pixels; None if unknown.

        It is within `OUTLIER_FACTOR` of the median.
        """
        if self._new:
            self._fit()
        if self._line is None:
            return None
        base, slope = self._line
        return min(
            max(base + slope * foot_y, self._middle / OUTLIER_FACTOR),
            self._middle * OUTLIER_FACTOR,
        )
