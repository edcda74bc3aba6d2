"""Missed detections: with paths A -> B -> C, objects that camera B misses go from A to C unseen.

A *path over a skipped camera* is a link from zone u to zone a, a passage from a to b through the
view of a camera, and a link from b to v. If the camera misses a share m of the passages, then for
every object recorded on the path ``odds = m / (1 - m)`` objects are recorded at u and next at v.
The odds for a pair of zones (u, v) are estimated from all other pairs that such paths join, as most
of these have no link of their own. A silent camera misses all objects, so the odds of its passages
are larger by the time that it was silent over the time that it was not. Transitions of a pair
beyond what the odds explain are the pair's own; a link must meet the rule for publishing with
these. Prediction counts on those that the odds explain, as most pairs have too few to be found one
by one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from camtopod.arrays import Bools, Floats, Ints, Rows, find_pairs
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable

ODDS_QUANTILE = 0.75
"""Weighted quantile of the odds of pairs that is used as the odds. It is above the median, as the
fit estimates no transitions for many pairs that have few.
"""
MISSED_SHARE_LEAST = 0.1
"""Least share of missed passages that is assumed, unless the setting allows less. Of hundreds of
zones, or with few events, the fit estimates no transitions for nearly all pairs.
"""
UNCERTAINTY = 2.0
"""Factor by which the number of missed passages may be larger than expected."""


class MissedTransitions(NamedTuple):
    """Transitions that missed detections make, by pair of zones; columns are (W,)."""

    source: Rows
    """Zone of departure."""
    target: Rows
    """Zone of arrival."""
    transitions: Floats
    """Expected transitions."""
    place: Floats
    """Mean lag, seconds."""
    width: Floats
    """Standard deviation of the lags, seconds."""

    def rows_in(self, source: Ints, target: Ints) -> tuple[Rows, Bools]:
        """Return the row of each pair among the pairs given, and whether it is there, (W,)."""
        return find_pairs((source, target), (self.source, self.target))


class Views(NamedTuple):
    """The views, whose cameras may have missed passages."""

    through: LinkTable
    """Pairs of zones by passages through a view."""
    silent: Floats
    """(zones,) time that the camera of each zone was silent, over the time that it was not."""


def own_transitions(between: LinkTable, misses: MissedTransitions) -> Floats:
    """Return the transitions (P,) of pairs of zones that missed detections do not explain."""
    row, exists = misses.rows_in(between.source, between.target)
    result = between.transit.total.astype(float)
    missed_counts = UNCERTAINTY * misses.transitions[exists]
    result[row[exists]] -= np.minimum(missed_counts, result[row[exists]])
    return result


def missed_transitions(
    between: LinkTable, views: Views, is_linked: Bools, missed_share_max: float
) -> MissedTransitions:
    """Return the transitions that missed detections make, by pair of zones.

    between: P pairs of zones by transitions between views.
    is_linked (P,): mask of the pairs that are links.
    missed_share_max: largest share of its passages that a camera is taken to miss.
    """
    paths, by_silence = skipped_paths(between, views, is_linked)
    row, exists = paths.rows_in(between.source, between.target)
    counts = np.maximum(np.where(exists, between.transit.total[row], 0.0) - by_silence, 0.0)
    limits = np.minimum((MISSED_SHARE_LEAST, 1.0), missed_share_max)
    odds = np.clip(odds_of_others(counts, paths.transitions), *(limits / (1.0 - limits)))
    return paths._replace(transitions=odds * paths.transitions + by_silence)


def skipped_paths(
    between: LinkTable, views: Views, is_linked: Bools
) -> tuple[MissedTransitions, Floats]:
    """Return the transitions at odds of 1, and those that silent cameras have missed, (W,).

    The arguments are as for `missed_transitions`. At odds of 1, cameras miss every second passage.
    """
    # Links by transitions; passages as a share of those that enter and those that leave.
    links = between.rows(np.flatnonzero(is_linked))
    through, silent = views
    passages = through.rows(np.flatnonzero(through.transit.total >= TRANSITIONS_MIN))
    ends = (links.source, links.target, passages.source, passages.target)
    zones = max(int(end.max(initial=0)) for end in ends) + 1
    entries, exits = (np.bincount(end, passages.transit.total, zones) for end in ends[2:])
    total = links.transit.total
    share = passages.transit.total / entries[passages.source] / exits[passages.target]

    def table(value: Floats, of: LinkTable) -> csr_array:
        return csr_array((value, (of.source, of.target)), shape=(zones, zones))

    link, view = table(total, links), table(share, passages)

    def of_pairs(sums: csr_array) -> Floats:
        """Return the sums over the paths of each pair, (W,)."""
        return sums[source, target] if len(source) else np.zeros(0)

    def along(of_links: Floats, of_passages: Floats) -> Floats:
        """Return the sums, over the paths of each pair, of a figure of their three parts, (W,)."""
        leg, stay = table(total * of_links, links), table(share * of_passages, passages)
        return of_pairs(leg @ view @ link + link @ stay @ link + link @ view @ leg)

    over = (link @ view @ link).tocoo()
    source, target = (end.astype(np.intp) for end in over.coords)
    place = along(links.transit.mean, passages.transit.mean) / over.data
    variance = along(links.transit.sd**2, passages.transit.sd**2) / over.data
    by_silence = of_pairs(link @ table(share * silent[passages.source], passages) @ link)
    return MissedTransitions(source, target, over.data, place, np.sqrt(variance)), by_silence


def odds_of_others(counts: Floats, expected: Floats) -> Floats:
    """Return the odds of a missed passage by all pairs of zones but one, for each of them, (W,).

    counts, expected (W,): transitions of each pair, by the fit and at odds of 1.

    They are a weighted quantile of the ratios; inf if there is no other pair.
    """
    # Without one pair, the weights from its place in the order on are less by its own.
    order = np.argsort(counts / expected, kind="stable")
    weight = expected[order]
    cumulative = np.cumsum(weight)
    other_weight = cumulative[-1:] - weight
    least = ODDS_QUANTILE * other_weight
    before = np.searchsorted(cumulative, least)
    after = np.searchsorted(cumulative, least + weight)
    place = np.arange(len(order))
    at = np.minimum(np.where(before < place, before, after), len(order) - 1)
    odds = np.empty(len(order))
    odds[order] = np.where(other_weight > 0.0, (counts / expected)[order][at], np.inf)
    return odds
