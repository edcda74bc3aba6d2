"""Hand-over: which open passages in other views may be of the object that leaves a view.

A passage is *open* while its object is in the view. At most one of the open passages in an
overlapping view is of the object that leaves. Each is weighted by its *offset*, the seconds by
which it began later than the passage that ends: the rate of passages of the same object at that
offset over the rate of passages of other objects. A topology version has both rates
(`camtopod.records.Overlaps`). `HandOver.in_view` finds the passages, `cameras_to_watch` the cameras
to look at.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from camtopod.columns import numbers
from camtopod.predict.hazards import model_of
from camtopod.predict.labels import Labels
from camtopod.predict.passages import Passage, RecentPassages
from camtopod.records import InView, Look, NextCamera, Topology
from camtopod.topology import STEPS, masses_of, offset_bins
from camtopod.words import sum_by_camera

PROBABILITY_MIN = 1e-3
"""Least probability of passages and cameras that are reported."""


_Overlap = tuple[str, float, list[float]]
"""A view that overlaps another: its camera, and the prior probability that it sees an object that
leaves the other; (bins + 1,) rate of passages of the same object over that of others, by bin of the
offset. The last element is 0, for offsets without a bin.
"""


class HandOver:
    """The overlapping views of a topology version."""

    def __init__(self, topology: Topology) -> None:
        model = model_of(topology)
        self._bins = offset_bins(model.lag_scale, model.lag_step)
        self._from: dict[str, list[_Overlap]] = {}
        if model.overlaps is None:
            return
        same_rates = masses_of(model.overlaps.same, self._bins)
        other_rates = masses_of(model.overlaps.others, self._bins)

        # Smaller rates are stored as 0.
        resolution = np.maximum(other_rates.max(axis=1, initial=0.0) / STEPS, 1e-9)
        odds = np.pad(same_rates / np.maximum(other_rates, resolution[:, None]), ((0, 0), (0, 1)))
        share = np.minimum(numbers(model.overlaps.share, np.float32, len(same_rates)), 0.98)
        ends = (
            numbers(raw, np.int32, len(same_rates)).tolist()
            for raw in (model.overlaps.camera, model.overlaps.to)
        )
        for camera, to, *overlap in zip(*ends, share.tolist(), odds.tolist(), strict=True):
            name = topology.cameras[camera].id
            self._from.setdefault(name, []).append((topology.cameras[to].id, *overlap))

    def overlaps(self, camera: str) -> bool:
        """Return True if any view overlaps that of the camera."""
        return camera in self._from

    def in_view(
        self,
        passage: Passage,
        t: float,
        passages: RecentPassages,
        offsets: dict[str, float],
        labels: Labels,
    ) -> list[InView]:
        """Return the open passages that may be of the object whose passage ends, likeliest first.

        passage: the passage that ends.
        t (seconds): corrected time of its exit.
        passages: the recent passages of all cameras.
        offsets (seconds): clock offset by camera.
        labels: the labels of the version.
        """
        result: list[InView] = []
        for camera, share, odds in self._from.get(passage.camera, ()):
            offset = offsets.get(camera, 0.0)
            tracks = passages.open_at(camera, t, t + offset)

            # Odds of each open passage against all others and against none of them.
            weights = [odds[self._bins.bin_of(candidate.t - passage.t)] for _, candidate in tracks]
            if labels:
                label = passage.label
                weights = [
                    weight * labels.of_two(label, candidate.label, candidate.entry)
                    for weight, (_, candidate) in zip(weights, tracks, strict=True)
                ]
            total = 1.0 - share + sum(weights)
            for (track, candidate), weight in zip(tracks, weights, strict=True):
                if weight > PROBABILITY_MIN * total:
                    result.append(InView(camera, track, candidate.t + offset, weight / total))
        return sorted(
            result,
            key=lambda candidate: (-candidate.probability, candidate.camera, candidate.track),
        )


def cameras_to_watch(in_view: Iterable[InView], next_cameras: Iterable[NextCamera]) -> list[Look]:
    """Return the cameras that see the object now, or are the next to see it, likeliest first.

    in_view: open passages that may be of the object.
    next_cameras: the cameras where it appears next, with probabilities.

    The next camera counts only if no camera sees the object now. Views are taken as independent of
    each other.
    """
    # Cameras that see the object now.
    shares = sum_by_camera(in_view)
    no_view = math.prod(1.0 - min(probability, 1.0) for probability in shares.values())

    # Cameras where the object appears next, if no camera sees it now.
    for camera, probability in sum_by_camera(next_cameras).items():
        shares[camera] = shares.get(camera, 0.0) + no_view * probability
    looks = [Look(camera, min(p, 1.0)) for camera, p in shares.items() if p >= PROBABILITY_MIN]
    return sorted(looks, key=lambda look: (-look.probability, look.camera))
