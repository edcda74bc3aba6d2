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
Ints = NDArray[np.int32]
PairKey = tuple[int, int, int, int]
Rows = dict[PairKey, Floats]

FRESH_SHARE = 0.5
"""A fit from nothing is due when this share of the window is new since the last one, so that early mistakes do not
stay and what creeps over many small steps starts again.
"""


def _key(source: ZoneRef, target: ZoneRef) -> PairKey:
    """Zones by camera and number: their indices change from one version to the next, these do not."""
    return source.camera, source.number, target.camera, target.number


class Memory:
    """Hazards of the last links, by zones."""

    def __init__(self) -> None:
        self._linked: Rows = {}
        self._persistence: Persistence = NO_PERSISTENCE
        self._fresh_at: int | None = None

    def fresh_due(self, learned: int, window: int) -> bool:
        """Whether to start from nothing: ``learned`` events have come in all, ``window`` count."""
        return self._fresh_at is None or learned - self._fresh_at >= FRESH_SHARE * window

    def started(self, learned: int) -> None:
        """A fit from nothing was made when ``learned`` events had come in."""
        self._fresh_at = learned

    def links(self, candidates: Candidates, scene: Scene, bins: LagBins) -> Known:
        """What the joint fit can go on from for these candidates."""
        return Known(_rows(self._linked, candidates.source, candidates.target, scene, bins), self._persistence)

    def remember(self, linked: Fit, scene: Scene) -> None:
        """Keep what the next fit can go on from."""
        self._linked = _by_zones(linked.hazard, linked.candidates.source, linked.candidates.target, scene)
        self._persistence = linked.persistence


def _rows(table: Rows, source: Ints, target: Ints, scene: Scene, bins: LagBins) -> Floats:
    none = np.zeros(bins.size)
    keys = (_key(scene.zones[u], scene.zones[v]) for u, v in zip(source, target, strict=True))
    return np.array([table.get(key, none) for key in keys]).reshape(-1, bins.size)


def _by_zones(hazard: Floats, source: Ints, target: Ints, scene: Scene) -> Rows:
    """The hazard of each pair of zones."""
    return {
        _key(scene.zones[u], scene.zones[v]): hazard[k] for k, (u, v) in enumerate(zip(source, target, strict=True))
    }
