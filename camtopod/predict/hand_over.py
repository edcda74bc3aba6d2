"""Hand-over: the open passages in other views that may be of the object that is leaving one.

Of the open passages in an overlapping view at most one is of the same object. Each is weighed by
its offset, the seconds by which it began later than the passage that ends: the rate of passages of
the same object at that offset over the rate of others (`overlapping`), as the topology version has
them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from camtopod.predict.open_passages import Passage, UnderWay
from camtopod.records import InView, Look, NextCamera, Topology
from camtopod.topology import LAG_SCALE_SECONDS, LAG_STEP, STEPS, offset_bins, on_bins

SHARE_MAX = 0.98
"""Largest probability that another camera sees the object, before its open passages are looked
at.
"""
PROBABILITY_MIN = 1e-3
"""Passages and cameras with a smaller probability are left out."""
SEEN_NOW_MIN = 0.3
"""Least probability with which a camera is said to see the object now."""
RATE_MIN = 1e-9
"""Least rate of passages of other objects in a bin, for each exit."""


class _Overlap(NamedTuple):
    """A view that overlaps the one that is left."""

    camera: str
    share: float
    odds: list[float]
    """(bins + 1,) same object over another one, by offset; 0 beyond the bins."""


class HandOver:
    """The overlapping views of a topology version."""

    def __init__(self, topology: Topology) -> None:
        model = topology.model
        scale, step = (model.lag_scale, model.lag_step) if model else (LAG_SCALE_SECONDS, LAG_STEP)
        self._bins = offset_bins(scale, step)
        self._from: dict[str, list[_Overlap]] = {}
        for row in (model.overlaps if model else None) or []:
            same, others = on_bins(row.same, self._bins), on_bins(row.others, self._bins)
            resolution = max(
                float(others.max()) / STEPS, RATE_MIN
            )  # smaller rates are 0 in a version
            odds = np.append(same / np.maximum(others, resolution), 0.0)
            self._from.setdefault(row.camera, []).append(
                _Overlap(row.to, min(row.share, SHARE_MAX), odds.tolist())
            )

    def overlaps(self, camera: str) -> bool:
        """Whether any view overlaps the camera's."""
        return camera in self._from

    def in_view(
        self, passage: Passage, t: float, under_way: UnderWay, ahead: dict[str, float]
    ) -> list[InView]:
        """Open passages that may be of the object whose ``passage`` ends at ``t`` (seconds in right
        time), the most probable first. ``ahead``: by how many seconds each camera's clock is fast.
        """
        found: list[InView] = []
        for camera, share, odds in self._from.get(passage.camera, ()):
            fast = ahead.get(camera, 0.0)
            tracks = under_way.open_at(camera, t, t + fast)
            weights = [odds[self._bins.bin_of(other.t - passage.t)] for _, other in tracks]
            total = 1.0 - share + sum(weights)
            for (track, other), weight in zip(tracks, weights, strict=True):
                if weight > PROBABILITY_MIN * total:
                    found.append(InView(camera, track, other.t + fast, weight / total))
        return sorted(found, key=lambda one: (-one.probability, one.camera, one.track))


def look(in_view: Iterable[InView], following: Iterable[NextCamera]) -> list[Look]:
    """Cameras by the probability that they see the object now or, if none does, are the next to see
    it. Views are taken as independent of each other.
    """
    # Cameras that see the object now
    now = added_up((one.camera, one.probability) for one in in_view)
    unseen = 1.0
    for probability in now.values():
        unseen *= 1.0 - min(probability, 1.0)

    # Cameras where it appears next, if none sees it now
    following_unseen = ((one.camera, unseen * one.probability) for one in following)
    seen = added_up([*now.items(), *following_unseen])
    looks = [Look(camera, min(p, 1.0)) for camera, p in seen.items() if p >= PROBABILITY_MIN]
    return sorted(looks, key=lambda one: (-one.probability, one.camera))


def seen_now(in_view: Iterable[InView]) -> list[Look]:
    """The cameras that probably see the object now, by their open passages together, the most
    probable first.
    """
    now = added_up((one.camera, one.probability) for one in in_view)
    likely = [Look(camera, min(p, 1.0)) for camera, p in now.items() if p >= SEEN_NOW_MIN]
    return sorted(likely, key=lambda one: (-one.probability, one.camera))


def added_up(shares: Iterable[tuple[str, float]]) -> dict[str, float]:
    """The sum of each camera's probabilities."""
    total: dict[str, float] = {}
    for camera, probability in shares:
        total[camera] = total.get(camera, 0.0) + probability
    return total
