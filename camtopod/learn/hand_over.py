"""Who sees an object at the moment it leaves a view: passages under way elsewhere, read off a topology version.

Of the passages under way in a view that overlaps at most one is of the same object. Each is weighed by how many of the
same object would have begun so much later than this one, beside how many of others (`overlapping`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from camtopod.learn.histograms import STEPS, on_bins
from camtopod.learn.lags import LagBins, offset_bins
from camtopod.learn.under_way import Passage, UnderWay
from camtopod.records import InView, Look, NextCamera, Topology

SHARE_MAX = 0.98
"""Nobody is surer than this to be seen by another camera while leaving one."""
PROBABILITY_MIN = 1e-3
"""Passages and cameras less likely than this are left out."""


class _Overlap(NamedTuple):
    camera: str
    share: float
    odds: list[float]
    """(bins,) of being the same object over being another one, by offset."""


class HandOver:
    """The overlapping views of a topology version."""

    def __init__(self, topology: Topology) -> None:
        model = topology.model
        rows = (model.overlaps if model else None) or []
        self._bins: LagBins | None = None
        self._from: dict[str, list[_Overlap]] = {}
        if model is None or not rows:
            return
        self._bins = offset_bins(LagBins(model.lag_min, model.lag_max, model.lag_scale, model.lag_step))
        for row in rows:
            same, others = on_bins(row.same, self._bins), on_bins(row.others, self._bins)
            least = max(float(others.max()) / STEPS, 1e-9)  # where there are fewer a version does not say how many
            overlap = _Overlap(row.to, min(row.share, SHARE_MAX), (same / np.maximum(others, least)).tolist())
            self._from.setdefault(row.camera, []).append(overlap)

    def overlaps(self, camera: str) -> bool:
        """Whether any view overlaps that of a camera."""
        return camera in self._from

    def in_view(self, passage: Passage, under_way: UnderWay, ahead: dict[str, float]) -> list[InView]:
        """Passages under way that may be of the object whose ``passage`` ends, the likeliest first. ``ahead``: by how
        many seconds each camera's clock is.
        """
        found: list[InView] = []
        for camera, share, odds in self._from.get(passage.camera, ()):
            tracks = under_way.tracks(camera)
            weights = [self._odds(odds, other.t - passage.t) for _, other in tracks]
            total = 1.0 - share + sum(weights)
            for (track, other), weight in zip(tracks, weights, strict=True):
                if weight > PROBABILITY_MIN * total:
                    found.append(InView(camera, track, other.t + ahead.get(camera, 0.0), weight / total))
        return sorted(found, key=lambda one: (-one.probability, one.camera, one.track))

    def _odds(self, odds: list[float], offset: float) -> float:
        assert self._bins is not None
        at = self._bins.bin_of(offset)
        return odds[at] if at >= 0 else 0.0


def look(in_view: Iterable[InView], following: Iterable[NextCamera]) -> list[Look]:
    """Cameras by the probability that they see the object now or, if none does, are the next to see it."""
    now: dict[str, float] = {}
    for one in in_view:
        now[one.camera] = now.get(one.camera, 0.0) + one.probability
    unseen = 1.0
    for seen in now.values():
        unseen *= 1.0 - min(seen, 1.0)
    probability = dict(now)
    for choice in following:
        probability[choice.camera] = probability.get(choice.camera, 0.0) + unseen * choice.probability
    looks = [Look(camera, min(p, 1.0)) for camera, p in probability.items() if p >= PROBABILITY_MIN]
    return sorted(looks, key=lambda one: (-one.probability, one.camera))
