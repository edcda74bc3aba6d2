"""Hand-over: the open passages in other views that may be of the object that is leaving one.

At most one of the open passages in an overlapping view is of the same object. Each is weighted by
its offset, the seconds by which it began later than the passage that ends: the rate of passages of
the same object at that offset over the rate of passages of others. Topology versions carry both
(`camtopod.records.Overlap`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from camtopod.predict.open_passages import OpenPassages, Passage
from camtopod.records import InView, Look, NextCamera, Topology
from camtopod.topology import LAG_SCALE_SECONDS, LAG_STEP, STEPS, masses_on_bins, offset_bins

SHARE_MAX = 0.98
"""Largest probability that another camera sees the object, before its open passages are known."""
PROBABILITY_MIN = 1e-3
"""Least probability of passages and cameras that are reported."""
SEEN_NOW_MIN = 0.3
"""Least probability with which `seen_now` returns a camera."""
RATE_MIN = 1e-9
"""Least expected number of passages of other objects in a bin, per exit."""


class _Overlap(NamedTuple):
    """A view that overlaps the one that is left."""

    camera: str
    share: float
    """Probability that its camera sees the object at the exit."""
    odds: list[float]
    """(bins + 1,) rate of the same object over the rate of others, by offset; 0 beyond the bins."""


class HandOver:
    """The overlapping views of a topology version."""

    def __init__(self, topology: Topology) -> None:
        model = topology.model
        scale, step = (model.lag_scale, model.lag_step) if model else (LAG_SCALE_SECONDS, LAG_STEP)
        self._bins = offset_bins(scale, step)
        self._from: dict[str, list[_Overlap]] = {}
        for row in (model.overlaps if model else None) or []:
            same, others = (
                masses_on_bins(row.same, self._bins),
                masses_on_bins(row.others, self._bins),
            )

            # Smaller rates are stored as 0.
            resolution = max(float(others.max()) / STEPS, RATE_MIN)
            odds = np.append(same / np.maximum(others, resolution), 0.0)
            self._from.setdefault(row.camera, []).append(
                _Overlap(row.to, min(row.share, SHARE_MAX), odds.tolist())
            )

    def overlaps(self, camera: str) -> bool:
        """Return True if any view overlaps the camera's."""
        return camera in self._from

    def in_view(
        self, passage: Passage, t: float, open_passages: OpenPassages, offsets: dict[str, float]
    ) -> list[InView]:
        """Return the open passages that may be of the object whose passage ends, likeliest first.

        t: corrected time of the exit, seconds.
        offsets: clock offset of each camera, seconds.
        """
        found: list[InView] = []
        for camera, share, odds in self._from.get(passage.camera, ()):
            offset = offsets.get(camera, 0.0)
            tracks = open_passages.open_at(camera, t, t + offset)

            # Odds of each against all others and against none.
            weights = [odds[self._bins.bin_of(other.t - passage.t)] for _, other in tracks]
            total = 1.0 - share + sum(weights)
            for (track, other), weight in zip(tracks, weights, strict=True):
                if weight > PROBABILITY_MIN * total:
                    found.append(InView(camera, track, other.t + offset, weight / total))
        return sorted(found, key=lambda one: (-one.probability, one.camera, one.track))


def cameras_to_watch(in_view: Iterable[InView], following: Iterable[NextCamera]) -> list[Look]:
    """Return the cameras by the probability that they see the object now or are the next to see it.

    The latter counts only if no camera sees it now. Views are taken as independent of each other.
    """
    # Cameras that see the object now.
    now = sum_by_camera((one.camera, one.probability) for one in in_view)
    unseen = 1.0
    for probability in now.values():
        unseen *= 1.0 - min(probability, 1.0)

    # Cameras where it appears next, if none sees it now.
    following_unseen = ((one.camera, unseen * one.probability) for one in following)
    seen = sum_by_camera([*now.items(), *following_unseen])
    looks = [Look(camera, min(p, 1.0)) for camera, p in seen.items() if p >= PROBABILITY_MIN]
    return sorted(looks, key=lambda one: (-one.probability, one.camera))


def seen_now(in_view: Iterable[InView]) -> list[Look]:
    """Return the cameras that probably see the object now, the most probable first.

    The probabilities of a camera's open passages are added.
    """
    now = sum_by_camera((one.camera, one.probability) for one in in_view)
    likely = [Look(camera, min(p, 1.0)) for camera, p in now.items() if p >= SEEN_NOW_MIN]
    return sorted(likely, key=lambda one: (-one.probability, one.camera))


def sum_by_camera(shares: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the sum of each camera's probabilities."""
    total: dict[str, float] = {}
    for camera, probability in shares:
        total[camera] = total.get(camera, 0.0) + probability
    return total
