"""How two cameras hang together: overlapped views, an unseen path, or not at all (thesis 4.5, table
4.4).

Two verdicts are given, and the views are overlapped when either says so. *By the sum rule* it
counts whether an object enters the one view during its passage through the other; *by the lags*,
whether most objects on a link are seen there before they have left here. They differ for views that
touch (the sum rule has a tolerance), and where lags are longer than the passages are: then the
passages there begin before those here, as with groups, or with a clock that is wrong.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from camtopod.records import Link, Pair, PairRelation, Relation, Zone

AHEAD_SHARE = 0.5
"""A link is overlapped when more than this share of its transitions appear before they have
left.
"""


def relation_of(ahead: float) -> Relation:
    """Relation of a link between two views from the share of its transitions with a negative
    lag.
    """
    return "overlapped" if ahead > AHEAD_SHARE else "unseen"


def camera_pairs(zones: Iterable[Zone], links: Iterable[Link], tolerance: float) -> list[Pair]:
    """Each related pair of cameras once, ids sorted, with both verdicts and why they differ if they
    do.

    With entries and exits in place of sightings, t(A,B) is the passage A -> B through the view,
    t(C,B) the link B -> C (negative where C is entered before B is left), and t(A,C) their sum.
    """
    camera_of = {zone.id: zone.camera for zone in zones}
    passages: dict[str, list[float]] = defaultdict(list)
    between: dict[tuple[str, str], list[Link]] = defaultdict(list)
    for link in links:
        here, there = camera_of[link.from_], camera_of[link.to]
        if link.relation == "visible":
            passages[link.to].append(link.transit.q50)
        elif here != there:
            between[min(here, there), max(here, there)].append(link)
    return [_pair(cameras, between[cameras], passages, tolerance) for cameras in sorted(between)]


def _pair(
    cameras: tuple[str, str], links: list[Link], passages: dict[str, list[float]], tolerance: float
) -> Pair:
    ahead = any(link.relation == "overlapped" for link in links)
    tested = [(stay, link.transit.q50) for link in links for stay in passages.get(link.from_, [])]
    during = any(sum_rule(stay, abs(stay + lag), abs(lag), tolerance) for stay, lag in tested)
    reason = None
    if not tested:
        reason = "no passage is known for the sum rule"
    elif during and not ahead:
        reason = "entered during the passage here, or within the tolerance after it, but mostly not before leaving"
    elif ahead and not during:
        reason = "entered before leaving here, but also before the passages here begin"
    return Pair(
        cameras,
        _relation(ahead or during),
        _relation(ahead),
        _relation(during) if tested else None,
        reason,
    )


def _relation(overlapped: bool) -> PairRelation:
    return "overlapped" if overlapped else "unseen_path"


_ROUNDING = 1e-9
"""Seconds allowed for rounding: in table 5.4, |4.45 - (1.6 + 3.3)| is exactly T = 0.45 and must
hold.
"""


def sum_rule(t_ab: float, t_ac: float, t_cb: float, tolerance: float) -> bool:
    """Table 4.4 on zones A, B of one camera and C of another: ``|t(A,B) - (t(A,C) + t(C,B))| <=
    T``, all in seconds.
    """
    return abs(t_ab - (t_ac + t_cb)) <= tolerance + _ROUNDING
