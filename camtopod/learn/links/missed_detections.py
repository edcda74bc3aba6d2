"""What missed passages explain away: A -> B -> C makes a link A -> C of whoever B did not see.

If a camera misses a share m of the passages through its view, then for every object seen on the way
u -> a, a -> b through that camera, b -> v there are ``odds = m / (1 - m)`` that were seen at u and
next at v, a transit, a stay and a transit later. How many that makes is known from the links and
the passages but for the odds. Those are read off all the other pairs of zones that such ways join:
most of them have no link of their own, so that what they have is the odds, and the few that have
one stand out. One camera often has too few such pairs, so the others count a little, too.

What a pair has beyond that, or at other lags, is its own. Several missed in a row need no more:
what the first one makes is a way itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Rows, rows_at, rows_together
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable
from camtopod.learn.settings import Settings
from camtopod.topology import LagBins

WINDOW_SD = 2.0
"""A way's lags lie within this many standard deviations of its median: those of its parts added up,
as a slow walker is slow on all of them ...
"""
WINDOW_SECONDS = 1.0
"""... and this."""
TELLING_TRANSITIONS_MIN = 5.0
"""A pair tells of the odds when its ways have at least this many expected transitions ..."""
TELLING_SHARE_MIN = 0.8
"""... and one camera this share of them."""
TELLING_TRANSITIONS_MAX = 50.0
"""It counts for as many of them, but for no more than this, as it may have a link of its own."""
OTHERS_TRANSITIONS = 150.0
"""For the odds of one camera the pairs of all together count as much as this many transitions over
it.
"""
ODDS_QUANTILE = 0.75
"""Of the pairs' odds, as the fit leaves nothing for many that have few transitions."""
MISSED_SHARE_MIN = 0.1
"""No camera is taken to miss less, if the setting allows as much: few events tell of few ways, and
with the least of them the fit has nothing left.
"""
UNCERTAINTY = 2.0
"""What is expected of missed passages is right to within this factor."""
OWN_SD = 2.0
"""What a link has of its own is at least so many standard deviations of what it has not."""


class Ways(NamedTuple):
    """Ways over one missed passage, (W,) each: the pair of zones they join (by its number), the
    camera, expected transitions if it saw every second one, median and spread of the lag in
    seconds.
    """

    pair: Rows
    camera: Rows
    expected: Floats
    median: Floats
    spread: Floats


def without_missed(
    between: LinkTable,
    through: LinkTable,
    found: NDArray[np.bool_],
    camera: Rows,
    settings: Settings,
) -> NDArray[np.bool_]:
    """``found`` (P,) less the links that missed passages explain. ``between`` are the pairs of
    zones of different cameras or visits, ``through`` those joined by passages; ``camera`` (zones,).
    """
    own = unexplained(between, through, found, camera, settings)
    total = np.maximum(between.transit.total, 1e-9)
    enough = np.maximum(TRANSITIONS_MIN, OWN_SD * np.sqrt(np.maximum(total - own, 0.0)))
    share = between.probability * own / total
    return found & (own >= enough) & (share >= settings.publish_probability_min)


def unexplained(
    between: LinkTable,
    through: LinkTable,
    found: NDArray[np.bool_],
    camera: Rows,
    settings: Settings,
) -> Floats:
    """Expected transitions (P,) of each pair of zones; of those ``found`` only what missed passages
    do not explain.
    """
    bins = LagBins(-settings.overlap_max_seconds, settings.transit_max_seconds)
    ways = find_ways(between, through, np.flatnonzero(found), camera)
    own = between.transit.total.astype(float)
    if len(ways.pair) == 0:
        return own
    pairs, at = np.unique(ways.pair, return_inverse=True)
    row, known = rows_at(between.source.astype(np.intp) * len(camera) + between.target, pairs)
    near = _inside(ways, at, between.delay[row], bins)
    seen = np.where(known, (near * between.counts[row]).sum(axis=1), 0.0)
    odds = Odds(ways, at, seen, settings.missed_share_max)
    for pair in np.flatnonzero(known & found[row]).tolist():
        explained = UNCERTAINTY * odds.expected(pair)
        own[row[pair]] -= min(explained, seen[pair])
    return own


def find_ways(between: LinkTable, through: LinkTable, links: Rows, camera: Rows) -> Ways:
    """All ways that lead along one of the ``links``, through a view and along another of the
    links.
    """
    zones = len(camera)
    passages = np.flatnonzero(through.transit.total >= TRANSITIONS_MIN)
    entered, left = (
        np.bincount(ends[passages], through.transit.total[passages], minlength=zones)
        for ends in (through.source, through.target)
    )
    first, middle = joined(between.target[links], through.source[passages])
    step, last = joined(through.target[passages][middle], between.source[links])
    k, j, m = links[first[step]], passages[middle[step]], links[last]
    total = between.transit.total
    expected = (
        total[k]
        * through.transit.total[j]
        / entered[through.source[j]]
        * total[m]
        / left[through.target[j]]
    )
    return Ways(
        between.source[k].astype(np.intp) * zones + between.target[m],
        camera[between.target[k]],
        expected,
        median(between)[k] + median(through)[j] + median(between)[m],
        between.transit.sd[k] + through.transit.sd[j] + between.transit.sd[m],
    )


class Odds:
    """Odds of a passage being missed, as pairs of zones tell of them.

    ``at`` (W,): row of each way in ``seen``, the transitions of each pair that the ways join at
    their lags.
    """

    def __init__(self, ways: Ways, at: Rows, seen: Floats, missed_share_max: float) -> None:
        cell, number = np.unique(
            at * (int(ways.camera.max()) + 1) + ways.camera, return_inverse=True
        )
        self._expected = np.bincount(number, ways.expected)
        self._pair, self._camera = np.divmod(cell, int(ways.camera.max()) + 1)
        self._start = np.searchsorted(self._pair, np.arange(len(seen) + 1))
        whole = np.bincount(self._pair, self._expected)[self._pair]
        tells = (self._expected >= TELLING_TRANSITIONS_MIN) & (
            self._expected >= TELLING_SHARE_MIN * whole
        )
        ratio = seen[self._pair[tells]] / whole[tells]
        order = np.argsort(ratio, kind="stable")
        self._ratio, self._teller, self._seer = (
            ratio[order],
            self._pair[tells][order],
            self._camera[tells][order],
        )
        self._weight = np.minimum(self._expected[tells][order], TELLING_TRANSITIONS_MAX)
        self._most = missed_share_max / (1.0 - missed_share_max)
        self._least = min(MISSED_SHARE_MIN / (1.0 - MISSED_SHARE_MIN), self._most)

    def expected(self, pair: int) -> float:
        """Transitions that missed passages make over all the ways of a pair."""
        rows = range(self._start[pair], self._start[pair + 1])
        return float(sum(self._expected[k] * self.of(self._camera[k], pair) for k in rows))

    def of(self, camera: int, judged: int) -> float:
        """Odds of one camera by what all pairs but the one that is judged tell."""
        weight = self._weight * (self._teller != judged)
        if not weight.any():
            return self._most
        reach = np.cumsum(weight * ((self._seer == camera) + OTHERS_TRANSITIONS / weight.sum()))
        ratio = self._ratio[np.searchsorted(reach, ODDS_QUANTILE * reach[-1])]
        return float(np.clip(ratio, self._least, self._most))


def median(table: LinkTable) -> Floats:
    """Median transit times (P,), seconds."""
    return table.transit.quantiles[:, 1]


def _inside(ways: Ways, at: Rows, delay: Floats, bins: LagBins) -> NDArray[np.bool_]:
    """Whether each lag bin lies where one of a pair's ways can end: (pairs, bins). ``delay``
    (pairs,): seconds to add to the lags of the bins.
    """
    reach = WINDOW_SD * ways.spread + WINDOW_SECONDS
    inside = np.zeros((len(delay), bins.size), bool)
    for rows in rows_together(len(at)):
        near = (
            np.abs(bins.centres + (delay[at[rows]] - ways.median[rows])[:, None])
            <= reach[rows, None]
        )
        np.logical_or.at(inside, at[rows], near)
    return inside


def joined(
    left: NDArray[np.signedinteger[Any]], right: NDArray[np.signedinteger[Any]]
) -> tuple[Rows, Rows]:
    """Every pair of rows that have the same key, as rows of ``left`` and of ``right``."""
    order = np.argsort(right, kind="stable")
    low, high = (np.searchsorted(right[order], left, side=side) for side in ("left", "right"))
    n = high - low
    rows = np.repeat(np.arange(len(left)), n)
    return rows, order[np.arange(len(rows)) + np.repeat(low - (np.cumsum(n) - n), n)]
