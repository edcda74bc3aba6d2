"""Missed detections: with paths A -> B -> C, objects that camera B misses make a false link A -> C.

A *path over a skipped camera* is a link from zone u to zone a, a passage from a to b through the
view of a camera, and a link from b to v. If the camera misses a share m of the passages, then for
every object recorded on the path ``odds = m / (1 - m)`` objects are recorded at u and next at v.
The odds are estimated from all other pairs of zones (u, v) that such paths join, as most of these
have no link of their own. Transitions of a pair beyond what the odds explain are the pair's own; a
link must meet the rule for publishing with these (`without_missed_detections`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Rows, find_rows
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable
from camtopod.learn.settings import Settings

TELLING_TRANSITIONS_MIN = 5.0
"""Least expected transitions, at odds of 1, of a pair of zones from which odds are estimated."""
TELLING_SHARE_MIN = 0.8
"""Least share of the expected transitions of such a pair that must be due to one skipped camera."""
TELLING_TRANSITIONS_MAX = 50.0
"""Largest weight of one such pair, in expected transitions, as it may have a link of its own."""
OTHERS_TRANSITIONS = 150.0
"""Weight, in transitions, of the pairs of all cameras together in the odds of one camera."""
ODDS_QUANTILE = 0.75
"""Weighted quantile of the odds of pairs that is used as the odds of a camera. It is above the
median, as the fit estimates no transitions for many pairs that have few.
"""
MISSED_SHARE_MIN = 0.1
"""Smallest share of missed passages assumed for a camera, unless the setting allows less. With few
events there are few paths, and the fit estimates no transitions for the rarest of them.
"""
UNCERTAINTY = 2.0
"""Factor by which the number of missed passages may be larger than expected."""
OWN_SD = 2.0
"""Least number of own transitions of a link, in standard deviations of the explained ones."""


class SkippedPaths(NamedTuple):
    """W paths over a skipped camera: a link, a passage and another link; columns are (W,)."""

    pair: Rows
    """Pair of zones that the path joins, as source * zones + target."""
    camera: Rows
    """Index of the skipped camera."""
    expected: Floats
    """Expected transitions at odds of 1, that is if the camera misses every second passage."""


def without_missed_detections(
    between: LinkTable,
    through: LinkTable,
    found: NDArray[np.bool_],
    camera: Rows,
    settings: Settings,
) -> NDArray[np.bool_]:
    """Return a mask (P,) of the links that missed detections do not explain.

    between: P pairs of zones by transitions between views.
    through: pairs of zones by passages through a view.
    found (P,): mask of the pairs of ``between`` that are links.
    camera (zones,): camera of each zone.
    """
    own_transitions = unexplained(between, through, found, camera, settings)
    total = np.maximum(between.transit.total, 1e-9)
    enough = np.maximum(TRANSITIONS_MIN, OWN_SD * np.sqrt(np.maximum(total - own_transitions, 0.0)))
    share = between.probability * own_transitions / total
    return found & (own_transitions >= enough) & (share >= settings.publish_probability_min)


def unexplained(
    between: LinkTable,
    through: LinkTable,
    found: NDArray[np.bool_],
    camera: Rows,
    settings: Settings,
) -> Floats:
    """Return the expected transitions (P,) of each pair; for links, those not explained.

    Arguments are as for `without_missed_detections`.
    """
    # Find the paths over skipped cameras.
    paths = find_skipped_paths(between, through, np.flatnonzero(found), camera)
    own_transitions = between.transit.total.astype(float)
    if len(paths.pair) == 0:
        return own_transitions

    # Transitions of the pairs that the paths join.
    pairs, at = np.unique(paths.pair, return_inverse=True)
    row, known = find_rows(between.source.astype(np.intp) * len(camera) + between.target, pairs)
    seen = np.where(known, own_transitions[row], 0.0)

    # Take off what missed passages explain.
    odds = MissedOdds(paths, at, seen, settings.missed_share_max)
    for pair in np.flatnonzero(known & found[row]).tolist():
        explained = UNCERTAINTY * odds.expected(pair)
        own_transitions[row[pair]] -= min(explained, seen[pair])
    return own_transitions


def find_skipped_paths(
    between: LinkTable, through: LinkTable, links: Rows, camera: Rows
) -> SkippedPaths:
    """Return all paths over a skipped camera that consist of given links and of passages.

    between: pairs of zones by transitions between views.
    through: pairs of zones by passages through a view.
    links: rows of ``between`` that are links.
    camera (zones,): camera of each zone.
    """
    # Passages, and their number by zone of entry and by zone of exit.
    zones = len(camera)
    passages = np.flatnonzero(through.transit.total >= TRANSITIONS_MIN)
    entered, exited = (
        np.bincount(ends[passages], through.transit.total[passages], minlength=zones)
        for ends in (through.source, through.target)
    )

    # Join link, passage and link where one ends and the next begins.
    first, middle = match_rows(between.target[links], through.source[passages])
    step, last = match_rows(through.target[passages][middle], between.source[links])
    k = links[first[step]]
    j = passages[middle[step]]
    m = links[last]

    # Transitions of the first link, times the shares of its objects that take the passage and the
    # second link.
    total = between.transit.total
    expected = (
        total[k]
        * through.transit.total[j]
        / entered[through.source[j]]
        * total[m]
        / exited[through.target[j]]
    )
    return SkippedPaths(
        between.source[k].astype(np.intp) * zones + between.target[m],
        camera[between.target[k]],
        expected,
    )


class MissedOdds:
    """Odds of a passage being missed, by camera, estimated from pairs of zones that paths join."""

    def __init__(
        self, paths: SkippedPaths, at: Rows, seen: Floats, missed_share_max: float
    ) -> None:
        """Collect the pairs of zones whose transitions are mostly due to one camera.

        paths: all paths over skipped cameras.
        at (W,): index in ``seen`` of the pair of zones that each path joins.
        seen (pairs,): expected transitions of each pair by the fit.
        missed_share_max: largest share of missed passages of any camera.
        """
        # Expected transitions at odds of 1, by pair and camera.
        cell, number = np.unique(
            at * (int(paths.camera.max()) + 1) + paths.camera, return_inverse=True
        )
        self._expected = np.bincount(number, paths.expected)
        self._pair, self._camera = np.divmod(cell, int(paths.camera.max()) + 1)
        self._start = np.searchsorted(self._pair, np.arange(len(seen) + 1))

        # Pairs from which the odds of one camera can be estimated, in order of these odds.
        whole = np.bincount(self._pair, self._expected)[self._pair]
        tells = (self._expected >= TELLING_TRANSITIONS_MIN) & (
            self._expected >= TELLING_SHARE_MIN * whole
        )
        ratio = seen[self._pair[tells]] / whole[tells]
        order = np.argsort(ratio, kind="stable")
        self._ratio = ratio[order]
        self._pair_of_ratio = self._pair[tells][order]
        self._camera_of_ratio = self._camera[tells][order]
        self._weight = np.minimum(self._expected[tells][order], TELLING_TRANSITIONS_MAX)

        self._most = missed_share_max / (1.0 - missed_share_max)
        self._least = min(MISSED_SHARE_MIN / (1.0 - MISSED_SHARE_MIN), self._most)

    def expected(self, pair: int) -> float:
        """Return the transitions that missed passages are expected to make of a pair of zones.

        pair: index of the pair, as in ``seen``.
        """
        rows = range(self._start[pair], self._start[pair + 1])
        return float(sum(self._expected[k] * self.of(self._camera[k], pair) for k in rows))

    def of(self, camera: int, judged: int) -> float:
        """Return the odds of one camera, estimated from all pairs of zones but ``judged``."""
        weight = self._weight * (self._pair_of_ratio != judged)
        if not weight.any():
            return self._most
        reach = np.cumsum(
            weight * ((self._camera_of_ratio == camera) + OTHERS_TRANSITIONS / weight.sum())
        )
        ratio = self._ratio[np.searchsorted(reach, ODDS_QUANTILE * reach[-1])]
        return float(np.clip(ratio, self._least, self._most))


def match_rows(
    left: NDArray[np.signedinteger[Any]], right: NDArray[np.signedinteger[Any]]
) -> tuple[Rows, Rows]:
    """Join two tables: return every pair of rows with equal keys, as two arrays of rows.

    left, right (n,), (m,): key of each row of the two tables.
    """
    order = np.argsort(right, kind="stable")
    low, high = (np.searchsorted(right[order], left, side=side) for side in ("left", "right"))
    n = high - low
    rows = np.repeat(np.arange(len(left)), n)
    return rows, order[np.arange(len(rows)) + np.repeat(low - (np.cumsum(n) - n), n)]
