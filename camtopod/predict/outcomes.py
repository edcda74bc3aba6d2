"""The possible outcomes of an exit, and the second opinion about them.

A version may have two opinions of where objects that leave a zone appear next: the hazards from
zone to zone, and paths between cameras (`camtopod.learn.paths`). `with_paths` puts both into
one set of outcomes, and `Outcomes.probabilities` averages what they say of an exit, now or later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Bools, Floats, Rows, Singles
from camtopod.records import CameraPath, Zone
from camtopod.topology import REACH_WIDTHS, LagBins, student_share

FLOOR = 1e-6
"""Least probability of leaving the site, and rate (1/s) that is added to the learned one of
arrivals from outside, so that some outcome is always possible.
"""
PATHS_WEIGHT_MAX = 0.5
"""Weight of the paths between cameras where no link of the zone is published."""


class Outcomes(NamedTuple):
    """Possible next appearances of objects that leave one zone; several may be at one target.

    There is a row for each target, and one for each path to it; the shares of each opinion and its
    leaving make 1.
    """

    targets: Rows
    """(rows,) index of the zone of each."""
    share: Floats
    """(rows,) share of the departures that appear next there."""
    leave: float
    """Share of the departures after which objects leave the site."""
    hazard: Singles
    """(rows, bins) hazard of each by lag, per second and exposed departure."""
    exposure: Floats
    """(bins,) share of the departures of this zone that are exposed to each lag."""
    doubt: Floats
    """(rows,) share of the transitions that may be spurious."""
    delay: Floats
    """(rows,) seconds to add to the lags of the bins; above 0 for long paths."""
    by_path: Bools
    """(rows,) True for the rows of the second opinion."""
    missed: Bools
    """(rows,) True for objects that a camera on the way misses."""
    leave_by_paths: float = 0.0
    """As ``leave``, of the second opinion; 0 if there is none."""
    paths_weight: float = 0.0
    """Weight of the second opinion."""

    @property
    def leaving(self) -> tuple[float, float]:
        """Share of the departures after which objects leave, by each opinion.

        Transitions that may be spurious are included.
        """
        return self.leave + float(self.share @ self.doubt), self.leave_by_paths

    @property
    def weight(self) -> Floats:
        """(rows,) weight of the opinion that each row is of."""
        return np.where(self.by_path, self.paths_weight, 1.0 - self.paths_weight)

    def exposure_by_row(self, exposure: Floats) -> Floats:
        """Return the exposure by row and lag, (rows, bins).

        exposure (bins,): exposure to lags from the exit. Transitions with a delay are always
            exposed.
        """
        result: Floats = np.maximum(exposure, (self.delay > 0.0)[:, None])
        return result

    def probabilities(self, odds: Floats, leave: float) -> tuple[Floats, float]:
        """Return the probability of each row for an exit, and that of leaving.

        odds (rows,), leave: odds of each row, and of leaving by the first opinion.

        Each opinion makes probabilities of its own odds, and these are averaged: an opinion that is
        sure and wrong outweighs the other by its odds, but not by its probabilities.
        """
        first = leave + float(odds[~self.by_path].sum())
        if not self.paths_weight:
            return odds / first, leave / first
        second = self.leave_by_paths + float(odds[self.by_path].sum())
        chance = odds * self.weight / np.where(self.by_path, second, first)
        return chance, 1.0 - float(chance.sum())


def with_paths(
    outcomes: Outcomes,
    link_share: float,
    paths: Sequence[CameraPath],
    zones: list[Zone],
    bins: LagBins,
) -> Outcomes:
    """Return the mean of the outcomes of an exit and of the paths from its camera.

    link_share: sum of the probabilities of the published links from its zone. The more of the
        shares rests on these, the less the paths count: links have been tested, paths have not.
    zones: all zones of the version.
    """
    total_share = max(float(outcomes.share.sum()), FLOOR)
    weight = PATHS_WEIGHT_MAX * max(1.0 - link_share / total_share, 0.0)
    if not weight:
        return outcomes

    # A path leads to all zones of its camera, as their entries do.
    targets: list[int] = []
    shares, hazards, delays = [], [], []
    exposure = outcomes.exposure
    for path in paths:
        zone_rows = [k for k, zone in enumerate(zones) if path.to in (zone.camera, zone.id)]
        entries = np.array([zones[k].entries for k in zone_rows]) + 1e-9
        mass, delay = _lags(path, bins)
        hazard = mass / (bins.widths * (1.0 if delay else exposure))
        share = path.share * entries / entries.sum()
        targets += zone_rows
        shares.append(share)
        hazards.append(share[:, None] * hazard)
        delays.append(np.full(len(zone_rows), delay))

    # Both opinions.
    no_rows = np.zeros((0, bins.size))
    beside = np.concatenate([np.zeros(0), *shares])
    return Outcomes(
        targets=np.append(outcomes.targets, np.array(targets, np.intp)),
        share=np.concatenate((outcomes.share, beside)),
        leave=outcomes.leave,
        hazard=np.concatenate([no_rows, outcomes.hazard, *hazards]).astype(np.float32),
        exposure=exposure,
        doubt=np.concatenate((outcomes.doubt, np.zeros(len(beside)))),
        delay=np.concatenate((outcomes.delay, *delays)),
        by_path=np.arange(len(outcomes.targets) + len(targets)) >= len(outcomes.targets),
        missed=np.concatenate((outcomes.missed, np.zeros(len(beside), np.bool_))),
        leave_by_paths=max(1.0 - float(beside.sum()), FLOOR),
        paths_weight=weight,
    )


def _lags(path: CameraPath, bins: LagBins) -> tuple[Floats, float]:
    """Return the mass of the lags of a path, (bins,), and the delay to be added to these lags."""
    delay = max(path.place - REACH_WIDTHS * path.width, 0.0)
    return np.diff(student_share(bins.edges, path.place - delay, path.width)), delay
