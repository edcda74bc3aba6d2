"""How tall a person looks in each row of the picture: a line through the heights of the people seen
so far."""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.typing as npt

SAMPLES_MAX = 400
SAMPLES_MIN = 20
OBJECTS_MIN = 2
"""One object says nothing about others."""
_REFIT_SAMPLES_MIN = 10
_REFIT_SHARE = 0.1
"""The line is fitted again after so many new samples, and this share of those there are."""


class Stature:
    """Learns height = a + b * foot row from whole, confirmed, single objects; robust to some that
    are none."""

    def __init__(self) -> None:
        self._rows: deque[float] = deque(maxlen=SAMPLES_MAX)
        self._heights: deque[float] = deque(maxlen=SAMPLES_MAX)
        self._objects: set[int] = set()
        self._new = 0
        self._line: tuple[float, float] | None = None
        self._middle = 0.0

    def add(self, track: int, foot_y: float, height: float) -> None:
        """One sighting of ``track``: feet in row ``foot_y``, ``height`` tall, pixels."""
        self._rows.append(foot_y)
        self._heights.append(height)
        if len(self._objects) < OBJECTS_MIN:
            self._objects.add(track)
        self._new += 1
        due = self._new >= max(_REFIT_SAMPLES_MIN, _REFIT_SHARE * len(self._rows))
        if due and len(self._rows) >= SAMPLES_MIN and len(self._objects) >= OBJECTS_MIN:
            self._fit()
            self._new = 0

    def _fit(self) -> None:
        rows, heights = np.array(self._rows), np.array(self._heights)
        self._middle = _median(heights)
        kept = np.ones(len(rows), bool)
        slope, base = 0.0, self._middle
        for _ in range(3):
            if np.ptp(rows[kept]) > self._middle:
                x, y = rows[kept], heights[kept]
                from_middle = x - x.mean()
                slope = float(from_middle @ y / (from_middle @ from_middle))
                base = float(y.mean() - slope * x.mean())
            residual = np.abs(heights - (base + slope * rows))
            kept = residual <= 2.5 * _median(residual) + 1e-9
        self._line = (base, slope)

    def height(self, foot_y: float) -> float | None:
        """Pixels; None until enough people were seen. At most a factor of 2.5 from the median."""
        if self._line is None:
            return None
        base, slope = self._line
        return min(max(base + slope * foot_y, self._middle / 2.5), self._middle * 2.5)


def _median(values: npt.NDArray[np.float64]) -> float:
    """NumPy's own takes five times as long for so few."""
    ordered, middle = np.sort(values), len(values) // 2
    return float(
        ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2
    )
