"""Missed detections: with paths A -> B -> C, objects that camera B misses make a false link A -> C.

A *path over a skipped camera* is a link from zone u to zone a, a passage from a to b through the
view of a camera, and a link from b to v. If the camera misses a share m of the passages, then for
every object recorded on the path ``odds = m / (1 - m)`` objects are recorded at u and next at v.
The odds for a pair of zones (u, v) are estimated from all other pairs that such paths join, as most
of these have no link of their own. Transitions of a pair beyond what the odds explain are the
pair's own; a link must meet the rule for publishing with these.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from camtopod.arrays import Bools, Floats, Rows, find_rows
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable
from camtopod.learn.settings import Settings

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


def without_missed_detections(
    between: LinkTable, through: LinkTable, found: Bools, settings: Settings
) -> Bools:
    """Return a mask (P,) of the links that missed detections do not explain.

    between: P pairs of zones by transitions between views.
    through: pairs of zones by passages through a view.
    found (P,): mask of the pairs of ``between`` that are links.
    """
    # Pairs of zones that paths over skipped cameras join, and their transitions.
    total = between.transit.total
    source, target, expected = skipped_paths(between, through, found)
    zones = max(int(between.target.max(initial=0)), int(target.max(initial=0))) + 1
    keys = between.source.astype(np.intp) * zones + between.target
    row, known = find_rows(keys, source * zones + target)
    seen = np.where(known, total[row], 0.0)

    # Take off what missed passages explain.
    limits = np.minimum((MISSED_SHARE_LEAST, 1.0), settings.missed_share_max)
    odds = np.clip(odds_of_others(seen, expected), *(limits / (1.0 - limits)))
    own = total.astype(float)
    explained = np.minimum(UNCERTAINTY * odds * expected, seen)
    own[row[known]] -= explained[known]
    share = between.probability * own / np.maximum(total, 1e-9)
    certain: Bools = found & (own >= TRANSITIONS_MIN) & (share >= settings.publish_probability_min)
    return certain


def skipped_paths(
    between: LinkTable, through: LinkTable, found: Bools
) -> tuple[Rows, Rows, Floats]:
    """Return the pairs of zones that paths over a skipped camera join.

    Return source, target, and expected transitions at odds of 1, that is if the cameras miss every
    second passage, (W,) each; arguments are as for `without_missed_detections`.
    """
    # Transitions of each link; and passages, as a share of those that enter and those that leave.
    ends = (between.source, between.target, through.source, through.target)
    zones = max(int(end.max(initial=0)) for end in ends) + 1
    links = csr_array(
        (between.transit.total[found], (between.source[found], between.target[found])),
        shape=(zones, zones),
    )
    kept = through.transit.total >= TRANSITIONS_MIN
    passages, entry, exit_ = through.transit.total[kept], through.source[kept], through.target[kept]
    entered, exited = (np.bincount(end, passages, minlength=zones) for end in (entry, exit_))
    share = passages / entered[entry] / exited[exit_]
    over = (links @ csr_array((share, (entry, exit_)), shape=(zones, zones)) @ links).tocoo()
    source, target = (end.astype(np.intp) for end in over.coords)
    return source, target, over.data


def odds_of_others(seen: Floats, expected: Floats) -> Floats:
    """Return the odds of a missed passage by all pairs of zones but one, for each of them, (W,).

    seen, expected (W,): transitions of each pair, by the fit and at odds of 1.

    They are a weighted quantile of the ratios; inf if there is no other pair.
    """
    # Without one pair, the weights from its place in the order on are less by its own.
    order = np.argsort(seen / expected, kind="stable")
    weight = expected[order]
    reached = np.cumsum(weight)
    others = reached[-1:] - weight
    least = ODDS_QUANTILE * others
    before = np.searchsorted(reached, least)
    after = np.searchsorted(reached, least + weight)
    place = np.arange(len(order))
    at = np.minimum(np.where(before < place, before, after), len(order) - 1)
    odds = np.empty(len(order))
    odds[order] = np.where(others > 0.0, (seen / expected)[order][at], np.inf)
    return odds
