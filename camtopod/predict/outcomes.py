"""The possible outcomes of an exit: those of all zones as one table, and those of one zone.

A version may have two opinions of where objects that leave a zone appear next: the hazards from
zone to zone, and paths between cameras (`second_opinion`). A table has the rows of both, and
`Outcomes.probabilities` averages what they say of an exit, now or later.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Bools, Floats, Rows, Singles
from camtopod.columns import numbers
from camtopod.records import Link, Onward, Topology
from camtopod.topology import LEAVE_FLOOR, LagBins, masses_of, masses_on_bins, smooth, weak_links

FLOOR = 1e-6
"""Least probability of leaving the site, and rate (1/s) that is added to the learned one of
arrivals from outside, so that some outcome is always possible.
"""
EXPOSURE_MIN = 0.02
"""Least share of the departures that counts as exposed to a lag."""
NORMAL_Q90 = 1.2816
"""0.9 quantile of the standard normal distribution."""


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
    is_missed: Bools
    """(rows,) True for objects that a camera on the way misses."""
    leave_by_paths: float = 0.0
    """As ``leave``, of the second opinion; 0 if there is none."""
    paths_weight: float = 0.0
    """Weight of the second opinion."""

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


class Table(NamedTuple):
    """The outcomes of all zones of a version; rows are sorted by ``source``.

    The columns of rows are those of `Outcomes`; ``source`` is the zone of departure.
    """

    source: Rows
    target: Rows
    share: Floats
    doubt: Floats
    delay: Floats
    hazard: Singles
    """(rows, bins + 1); the last is zero, for lags without a bin."""
    by_path: Bools
    is_missed: Bools
    leave: Floats
    """(zones,) share of the departures after which objects leave, by the first opinion."""
    leave_by_paths: Floats
    """(zones,) the same by the second opinion; 0 if there is none."""
    paths_weight: Floats
    """(zones,) weight of the second opinion."""

    @property
    def weight(self) -> Floats:
        """(rows,) weight of the opinion that each row is of."""
        second = self.paths_weight[self.source]
        return np.where(self.by_path, second, 1.0 - second)

    def outcomes(self, zone: int, rows: slice, exposure: Floats) -> Outcomes:
        """Return the outcomes of a zone, which are in some rows."""
        return Outcomes(
            targets=self.target[rows],
            share=self.share[rows],
            leave=float(self.leave[zone]),
            hazard=self.hazard[rows, :-1],
            exposure=exposure,
            doubt=self.doubt[rows],
            delay=self.delay[rows],
            by_path=self.by_path[rows],
            is_missed=self.is_missed[rows],
            leave_by_paths=float(self.leave_by_paths[zone]),
            paths_weight=float(self.paths_weight[zone]),
        )


def of_posterior(onward: Onward, zones: int, bins: LagBins) -> Table:
    """Return the table of the outcomes in a model; ``zones``: their number."""
    number = numbers(onward.number, np.int32, zones)
    rows = int(number.sum())
    hazard = np.zeros((rows, bins.size + 1), np.float32)
    np.divide(masses_of(onward.hazard, bins), bins.widths, out=hazard[:, :-1], casting="same_kind")
    share, doubt, delay = (
        numbers(raw, np.float32, rows).astype(float)
        for raw in (onward.share, onward.doubt, onward.delay)
    )
    return _one_opinion(
        np.repeat(np.arange(zones), number),
        numbers(onward.to, np.int32, rows).astype(np.intp),
        share,
        doubt,
        delay,
        hazard,
        numbers(onward.missed, np.uint8, rows) > 0,
        np.maximum(numbers(onward.leave, np.float32, zones).astype(float), FLOOR),
    )


def of_links(topology: Topology, bins: LagBins, exposure: Floats) -> Table:
    """Return the table of the outcomes that links tell, weak ones included.

    exposure (zones, bins): share of the departures of each zone that are exposed to each lag.
    """
    index = {zone.id: k for k, zone in enumerate(topology.zones)}
    links = [
        link
        for link in (*topology.links, *weak_links(topology))
        if link.relation != "visible" and link.from_ in index and link.to in index
    ]
    links.sort(key=lambda link: index[link.from_])
    source, target = (
        np.array([index[zone] for zone in ends], np.intp)
        for ends in ([link.from_ for link in links], [link.to for link in links])
    )

    # Hazard: expected arrivals per second, over the share of departures that is exposed.
    share = np.array([link.probability for link in links], float)
    delay = np.array([link.histogram.delay if link.histogram else 0.0 for link in links], float)
    spread = np.zeros((len(links), bins.size))
    if links:
        spread = smooth(np.stack([_counts(link, bins) for link in links]))[0]
    spread /= np.maximum(spread.sum(axis=1, keepdims=True), 1e-300)
    exposed_share = np.where(delay[:, None] > 0.0, 1.0, exposure[source])
    hazard = np.zeros((len(links), bins.size + 1), np.float32)
    hazard[:, :-1] = share[:, None] * spread / (bins.widths * exposed_share)
    seen_again = np.bincount(source, share, minlength=len(index))
    leave = np.maximum(1.0 - seen_again, LEAVE_FLOOR)
    zeros = np.zeros(len(links))
    return _one_opinion(source, target, share, zeros, delay, hazard, zeros > 0, leave)


def _one_opinion(
    source: Rows,
    target: Rows,
    share: Floats,
    doubt: Floats,
    delay: Floats,
    hazard: Singles,
    is_missed: Bools,
    leave: Floats,
) -> Table:
    """Return a table without a second opinion."""
    by_path, zeros = np.zeros(len(source), np.bool_), np.zeros(len(leave))
    return Table(
        source, target, share, doubt, delay, hazard, by_path, is_missed, leave, zeros, zeros
    )


def _counts(link: Link, bins: LagBins) -> Floats:
    """Return the transitions of a link by lag (bins,); without histogram, normally distributed."""
    if link.histogram is not None:
        return masses_on_bins(link.histogram, bins)
    sd = max((link.transit.q90 - link.transit.q10) / (2 * NORMAL_Q90), 0.5)
    shape = np.exp(-0.5 * ((bins.centres - link.transit.q50) / sd) ** 2) * bins.widths
    return shape / max(float(shape.sum()), 1e-300) * link.transitions


def exposures(stay: Singles, bins: LagBins) -> Floats:
    """Return the share of the departures at each zone that are exposed to each lag, (zones, bins).

    stay (zones, deciles): deciles of the dwell times; 0 if unknown.

    For lags before the exit, it is the share of the passages that had begun by then; for lags after
    the exit, and where it is unknown, it is 1.
    """
    past = np.flatnonzero(bins.edges[1:] <= 0)
    rows = np.flatnonzero(stay.any(axis=1))
    deciles = stay[rows].astype(float)
    shorter = np.zeros((len(rows), len(past)))
    for low, width in zip(deciles[:, :-1].T, np.diff(deciles, axis=1).T, strict=True):
        reach = (-bins.centres[past] - low[:, None]) / np.maximum(width, 1e-9)[:, None]
        shorter += np.clip(reach, 0.0, 1.0)
    result = np.ones((len(stay), bins.size))
    begun_share = 1.0 - shorter / (deciles.shape[1] - 1)
    result[np.ix_(rows, past)] = np.clip(begun_share, EXPOSURE_MIN, 1.0)
    return result
