"""What one fit hands to the next, so that refreshing the links after a few more events is cheap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.candidates import Candidates
from camtopod.learn.joint import Fit, Known
from camtopod.learn.lags import LagBins
from camtopod.learn.scene import Scene, ZoneRef
from camtopod.learn.slowness import NO_PERSISTENCE, Persistence

Floats = NDArray[np.float64]
PairKey = tuple[int, int, int, int]

FRESH_GROWTH = 1.5
"""A fit from nothing is due when the window has grown by this since the last one, so that early mistakes do not stay.
"""


def _key(source: ZoneRef, target: ZoneRef) -> PairKey:
    """Zones by camera and number: their indices change from one version to the next, these do not."""
    return source.camera, source.number, target.camera, target.number


class Memory:
    """Hazards of the last posterior and of its links, by zones."""

    def __init__(self) -> None:
        self._posterior: dict[PairKey, Floats] = {}
        self._linked: dict[PairKey, Floats] = {}
        self._persistence: Persistence = NO_PERSISTENCE
        self._fresh_size = 0

    def recall(self, candidates: Candidates, scene: Scene, bins: LagBins, window: int) -> Known | None:
        """What to go on from for these candidates; None when a fit from nothing is due."""
        if window >= FRESH_GROWTH * self._fresh_size:
            return None
        keys = [_key(scene.zones[u], scene.zones[v]) for u, v in zip(candidates.source, candidates.target, strict=True)]
        none = np.zeros(bins.size)
        posterior, linked = (
            np.array([table.get(key, none) for key in keys]).reshape(-1, bins.size)
            for table in (self._posterior, self._linked)
        )
        return Known(posterior, linked, self._persistence)

    def remember(self, posterior: Fit, linked: Fit, scene: Scene, window: int, fresh: bool) -> None:
        """Keep what the next fit can go on from; ``fresh``: these were made from nothing."""
        self._posterior, self._linked = _by_zones(posterior, scene), _by_zones(linked, scene)
        self._persistence = linked.persistence
        if fresh:
            self._fresh_size = window


def _by_zones(fit: Fit, scene: Scene) -> dict[PairKey, Floats]:
    """The hazard of each pair of zones."""
    pairs = zip(fit.candidates.source, fit.candidates.target, strict=True)
    return {_key(scene.zones[u], scene.zones[v]): fit.hazard[k] for k, (u, v) in enumerate(pairs)}
