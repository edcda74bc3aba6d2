"""Relation of two cameras: overlapped views, an unseen path, or none (thesis 4.5, table 4.4).

Two cameras are related if a link joins zones of the two. Two tests of overlap are made from these
links, and the views count as overlapped if either finds an overlap:

* *Sum rule* (thesis): an object enters the second view during its passage through the first.
* *Lags*: most transitions on a link have a negative lag, so the object enters the second view
  before it leaves the first.

The results differ for views that touch, as the sum rule has a tolerance. They also differ where
negative lags are longer than the passages (of groups, or by a wrong clock): passages through the
second view then begin before those through the first.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from camtopod.records import Link, Pair, PairRelation, Relation, Zone

NEGATIVE_LAG_SHARE_MIN = 0.5
"""Share of transitions with a negative lag above which a link is overlapped."""
RELATIONS: dict[bool, PairRelation] = {True: "overlapped", False: "unseen_path"}
"""Relation of two related cameras by the result of a test of overlap."""
REASONS = {
    (False, True): "entered during the passage here, or within the tolerance after it, "
    "but mostly not before leaving",
    (True, False): "entered before leaving here, but also before the passages here begin",
}
"""Why the tests, of lags and of sums, may differ."""


def relation_of(ahead: float) -> Relation:
    """Return the relation of a link between two views.

    ahead: share of the link's transitions with a negative lag.
    """
    if ahead > NEGATIVE_LAG_SHARE_MIN:
        return "overlapped"
    return "unseen"


def find_camera_pairs(zones: Iterable[Zone], links: Iterable[Link], tolerance: float) -> list[Pair]:
    """Return each related pair of cameras once, ids sorted, with the results of both tests.

    zones, links: all zones, and the links between them with transit times in corrected time.
    tolerance (seconds): T of the sum rule.

    If the results differ, the pair has the reason. Entries and exits take the place of the thesis's
    sightings: t(A,B) is the dwell time of the passage from A to B through the first view, t(B,C)
    the transit time of the link B -> C (negative if C is entered before B is left), and t(A,C) the
    sum of the two.
    """
    # Collect the median dwell times by zone of exit, and the links by pair of cameras.
    camera_of = {zone.id: zone.camera for zone in zones}
    passages: dict[str, list[float]] = defaultdict(list)
    between: dict[tuple[str, str], list[Link]] = defaultdict(list)
    for link in links:
        source = camera_of[link.from_]
        target = camera_of[link.to]
        if link.relation == "visible":
            passages[link.to].append(link.transit.q50)
        elif source != target:
            between[min(source, target), max(source, target)].append(link)
    return [_pair(cameras, between[cameras], passages, tolerance) for cameras in sorted(between)]


def _pair(
    cameras: tuple[str, str], links: list[Link], passages: dict[str, list[float]], tolerance: float
) -> Pair:
    """Return the relation of two cameras from the links between them.

    links: the links that join zones of the two.
    passages: by zone, the median dwell times (seconds) of the visible links that end there.
    tolerance (seconds): T of the sum rule.
    """
    # The two tests: lags, and the sum rule on every passage with a link that continues it.
    ahead = any(link.relation == "overlapped" for link in links)
    pairs = [(dwell, link.transit.q50) for link in links for dwell in passages.get(link.from_, [])]
    during = any(sum_rule(dwell, abs(dwell + lag), abs(lag), tolerance) for dwell, lag in pairs)

    # Explain a difference.
    by_sums: PairRelation | None = None
    reason = None
    if not pairs:
        reason = "no passage is known for the sum rule"
    else:
        by_sums = RELATIONS[during]
        reason = REASONS.get((ahead, during))
    return Pair(cameras, RELATIONS[ahead or during], RELATIONS[ahead], by_sums, reason)


_ROUNDING = 1e-9
"""Seconds allowed for rounding in the sum rule.

In table 5.4, |4.45 - (1.6 + 3.3)| is exactly T = 0.45 and must pass.
"""


def sum_rule(t_ab: float, t_ac: float, t_cb: float, tolerance: float) -> bool:
    """Return True if ``|t(A,B) - (t(A,C) + t(C,B))| <= T``, the overlap test of table 4.4.

    A and B are zones of one camera, C is a zone of another; all times in seconds.
    """
    return abs(t_ab - (t_ac + t_cb)) <= tolerance + _ROUNDING
