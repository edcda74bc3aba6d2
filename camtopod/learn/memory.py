"""What one fit hands to the next, so that refreshing the links after a few more events is cheap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.candidates import Candidates
from camtopod.learn.joint import Fit
from camtopod.learn.lags import LagBins
from camtopod.learn.scene import Scene, ZoneRef
from camtopod.learn.slowness import NO_PERSISTENCE, Persistence

Floats = NDArray[np.float64]
PairKey = tuple[int, int, int, int]

FRESH_GROWTH = 1.5
"""A fit from nothing is due when the window has grown by this since the last one, so that early mistakes do not stay."""


def _key(source: ZoneRef, target: ZoneRef) -> PairKey:
    """Zones by camera and number: their indices change from one version to the next, these do not."""
    return source.camera, source.number, target.camera, target.number


class Memory:
    """Hazards and persistence of the last fit."""

    def __init__(self) -> None:
        self._hazards: dict[PairKey, Floats] = {}
        self._persistence: Persistence = NO_PERSISTENCE
        self._fresh_size = 0

    def recall(
        self, candidates: Candidates, scene: Scene, bins: LagBins, window: int
    ) -> tuple[Floats, Persistence] | None:
        """Hazards (P, bins) and persistence to go on from; None when a fit from nothing is due."""
        if window >= FRESH_GROWTH * self._fresh_size:
            return None
        none = np.zeros(bins.size)
        rows = [
            self._hazards.get(_key(scene.zones[source], scene.zones[target]), none)
            for source, target in zip(candidates.source, candidates.target, strict=True)
        ]
        return np.array(rows).reshape(-1, bins.size), self._persistence

    def remember(self, fit: Fit, scene: Scene, window: int, fresh: bool) -> None:
        """Keep what the next fit can go on from."""
        pairs = zip(fit.candidates.source, fit.candidates.target, strict=True)
        self._hazards = {
            _key(scene.zones[source], scene.zones[target]): fit.hazard[k] for k, (source, target) in enumerate(pairs)
        }
        self._persistence = fit.persistence
        if fresh:
            self._fresh_size = window
