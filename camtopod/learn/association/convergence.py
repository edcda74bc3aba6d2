"""When the iterations of EM end: as soon as they move hardly any expected transitions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile

import numpy as np

from camtopod.arrays import Floats

ITERATIONS = 6
"""Usual number of iterations after which a run ends, converged or not."""
TOLERANCE = 0.001
"""Share of all expected transitions that an iteration may move between pairs of zones, or paths, if
the fit has converged.
"""


class ConvergenceMonitor:
    """The iterations of one run of EM: iterate over it, and `report` once an iteration.

    iterations_max: number of iterations after which the run ends, converged or not.
    """

    def __init__(self, iterations_max: int = ITERATIONS) -> None:
        self.iterations_max = iterations_max
        self.history: list[float] = []
        """Share of all expected transitions that was moved by each iteration from the second on."""
        self._transitions: Floats | None = None

    def __iter__(self) -> Iterator[int]:
        """Return the numbers of the iterations, from 0."""
        return takewhile(lambda _: not self.converged, range(self.iterations_max))

    @property
    def converged(self) -> bool:
        """True if the last iteration moved hardly any transitions (`TOLERANCE`)."""
        return bool(self.history) and self.history[-1] <= TOLERANCE

    def report(self, transitions: Floats) -> None:
        """Take the expected transitions of each pair of zones, or path, after an iteration."""
        if self._transitions is not None:
            change = float(np.abs(transitions - self._transitions).sum())
            self.history.append(change / max(float(transitions.sum()), 1e-9))
        self._transitions = transitions
