"""Missed detections: with A -> B -> C, objects that B misses make a spurious link A -> C.

If a camera misses a share m of the passages through its view, then for every object seen on the
path u -> a, a -> b through that view, b -> v, there are ``odds = m / (1 - m)`` objects seen at u
and next at v, after a transit, a dwell and a transit time. The links and passages give the number
of such transitions but for the odds. The odds are estimated from all other pairs of zones that such
paths join: most of them have no link of their own, so their transitions give the odds, and the few
that have one stand out. One camera often has too few such pairs, so those of the other cameras
count a little, too.

Transitions of a pair beyond this number, or at other lags, are its own. Several misses in a row
need no special treatment: the link that the first one makes is part of a path itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Rows, find_rows, row_slices
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable
from camtopod.learn.settings import Settings
from camtopod.topology import LagBins

WINDOW_SD = 2.0
"""Half width of the lags of a path around its median, in sums of its parts' standard deviations.

They are added up, as a slow object is slow on all parts.
"""
WINDOW_SECONDS = 1.0
"""Seconds added to that half width."""
TELLING_TRANSITIONS_MIN = 5.0
"""Least expected transitions, at odds of 1, of a pair of zones from which odds are estimated."""
TELLING_SHARE_MIN = 0.8
"""Least share of those transitions that must be due to one camera."""
TELLING_TRANSITIONS_MAX = 50.0
"""Largest weight of one such pair, in expected transitions, as it may have a link of its own."""
OTHERS_TRANSITIONS = 150.0
"""Weight of the pairs of all cameras together beside those of the camera itself, in transitions."""
ODDS_QUANTILE = 0.75
"""Weighted quantile of the pairs' odds that is used.

It is above the median, as the fit leaves no transitions for many pairs that have few.
"""
MISSED_SHARE_MIN = 0.1
"""Smallest share of missed passages assumed for a camera, unless the setting allows less.

With few events there are few paths, and the fit leaves no transitions for the smallest of them.
"""
UNCERTAINTY = 2.0
"""Factor within which the expected number of missed passages is right."""
OWN_SD = 2.0
"""A link's own transitions must be at least this many standard deviations of the explained ones."""


class SkippedPaths(NamedTuple):
    """Paths over a skipped camera, (W,) each: a link, a passage and another link."""

    pair: Rows
    """Pair of zones that the path joins: source * zones + target."""
    camera: Rows
    """The camera that is skipped."""
    expected: Floats
    """Expected transitions at odds of 1, if the camera misses every second passage."""
    median: Floats
    """Median of the lag, seconds."""
    spread: Floats
    """Spread of the lag, seconds."""


def without_missed_detections(
    between: LinkTable,
    through: LinkTable,
    found: NDArray[np.bool_],
    camera: Rows,
    settings: Settings,
) -> NDArray[np.bool_]:
    """Return the links of ``found`` that missed detections do not explain.

    between: pairs of zones of different cameras, or of different visits to one.
    through: pairs of zones joined by passages through a view.
    found (P,): rows of ``between`` that are links.
    camera (zones,): camera of each zone.
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
    """Return the expected transitions (P,) of each pair; of links, only those not explained.

    Arguments are those of `without_missed_detections`.
    """
    # Find the paths over skipped cameras.
    bins = LagBins(-settings.overlap_max_seconds, settings.transit_max_seconds)
    ways = find_skipped_paths(between, through, np.flatnonzero(found), camera)
    own = between.transit.total.astype(float)
    if len(ways.pair) == 0:
        return own

    # Transitions of the pairs that the paths join, at the lags of the paths.
    pairs, at = np.unique(ways.pair, return_inverse=True)
    row, known = find_rows(between.source.astype(np.intp) * len(camera) + between.target, pairs)
    near = _inside(ways, at, between.delay[row], bins)
    seen = np.where(known, (near * between.counts[row]).sum(axis=1), 0.0)

    # Take off what missed passages explain.
    odds = MissedOdds(ways, at, seen, settings.missed_share_max)
    for pair in np.flatnonzero(known & found[row]).tolist():
        explained = UNCERTAINTY * odds.expected(pair)
        own[row[pair]] -= min(explained, seen[pair])
    return own


def find_skipped_paths(
    between: LinkTable, through: LinkTable, links: Rows, camera: Rows
) -> SkippedPaths:
    """Return all paths along one of the ``links``, through a view and along another of the links.

    links: rows of ``between``.
    camera (zones,): camera of each zone.
    """
    # Passages, and their number by zone of entry and by zone of exit.
    zones = len(camera)
    passages = np.flatnonzero(through.transit.total >= TRANSITIONS_MIN)
    entered, left = (
        np.bincount(ends[passages], through.transit.total[passages], minlength=zones)
        for ends in (through.source, through.target)
    )

    # Join link, passage and link where one ends and the next begins.
    first, middle = match_rows(between.target[links], through.source[passages])
    step, last = match_rows(through.target[passages][middle], between.source[links])
    k, j, m = links[first[step]], passages[middle[step]], links[last]

    # Transitions of the first link, times the shares of its objects that take the passage and the
    # second link.
    total = between.transit.total
    expected = (
        total[k]
        * through.transit.total[j]
        / entered[through.source[j]]
        * total[m]
        / left[through.target[j]]
    )
    return SkippedPaths(
        between.source[k].astype(np.intp) * zones + between.target[m],
        camera[between.target[k]],
        expected,
        median(between)[k] + median(through)[j] + median(between)[m],
        between.transit.sd[k] + through.transit.sd[j] + between.transit.sd[m],
    )


class MissedOdds:
    """Odds of a passage being missed, by camera, estimated from pairs of zones."""

    def __init__(self, ways: SkippedPaths, at: Rows, seen: Floats, missed_share_max: float) -> None:
        """Collect the pairs of zones whose transitions are mostly due to one camera.

        at (W,): row in ``seen`` of the pair that each path joins.
        seen (pairs,): transitions of each pair at the lags of its paths.
        missed_share_max: largest share of missed passages of any camera.
        """
        # Expected transitions at odds of 1, by pair and camera.
        cell, number = np.unique(
            at * (int(ways.camera.max()) + 1) + ways.camera, return_inverse=True
        )
        self._expected = np.bincount(number, ways.expected)
        self._pair, self._camera = np.divmod(cell, int(ways.camera.max()) + 1)
        self._start = np.searchsorted(self._pair, np.arange(len(seen) + 1))

        # Pairs that tell of one camera, and their odds, ascending.
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
        """Return the transitions that missed passages make over all paths of a pair."""
        rows = range(self._start[pair], self._start[pair + 1])
        return float(sum(self._expected[k] * self.of(self._camera[k], pair) for k in rows))

    def of(self, camera: int, judged: int) -> float:
        """Return the odds of one camera, estimated from all pairs but ``judged``."""
        weight = self._weight * (self._teller != judged)
        if not weight.any():
            return self._most
        reach = np.cumsum(weight * ((self._seer == camera) + OTHERS_TRANSITIONS / weight.sum()))
        ratio = self._ratio[np.searchsorted(reach, ODDS_QUANTILE * reach[-1])]
        return float(np.clip(ratio, self._least, self._most))


def median(table: LinkTable) -> Floats:
    """Return the median transit times (P,), seconds."""
    return table.transit.quantiles[:, 1]


def _inside(ways: SkippedPaths, at: Rows, delay: Floats, bins: LagBins) -> NDArray[np.bool_]:
    """Return a mask (pairs, bins) of the lag bins where one of a pair's paths can end.

    at (W,): row of the pair that each path joins.
    delay (pairs,): seconds to add to the lags of the bins.
    """
    reach = WINDOW_SD * ways.spread + WINDOW_SECONDS
    inside = np.zeros((len(delay), bins.size), bool)
    for rows in row_slices(len(at)):
        near = (
            np.abs(bins.centres + (delay[at[rows]] - ways.median[rows])[:, None])
            <= reach[rows, None]
        )
        np.logical_or.at(inside, at[rows], near)
    return inside


def match_rows(
    left: NDArray[np.signedinteger[Any]], right: NDArray[np.signedinteger[Any]]
) -> tuple[Rows, Rows]:
    """Return every pair of rows that have the same key, as rows of ``left`` and of ``right``."""
    order = np.argsort(right, kind="stable")
    low, high = (np.searchsorted(right[order], left, side=side) for side in ("left", "right"))
    n = high - low
    rows = np.repeat(np.arange(len(left)), n)
    return rows, order[np.arange(len(rows)) + np.repeat(low - (np.cumsum(n) - n), n)]
