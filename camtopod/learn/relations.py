"""How two cameras hang together: overlapped views, an unseen path, or not at all (thesis 4.5, table 4.4)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from camtopod.learn.overlap import sum_rule
from camtopod.records import Link, Pair, PairRelation, Relation, Zone

AHEAD_SHARE = 0.5
"""A link is overlapped when more than this share of its transitions appear before they have left."""


def relation_of(ahead: float) -> Relation:
    """Relation of a link between two views from the share of its transitions with a negative lag."""
    return "overlapped" if ahead > AHEAD_SHARE else "unseen"


def camera_pairs(zones: Iterable[Zone], links: Iterable[Link], tolerance: float) -> list[Pair]:
    """Each related pair of cameras once, ids sorted.

    With entries and exits in place of sightings, t(A,B) is the passage A -> B through the view, t(C,B) the link B -> C
    (negative where C is entered before B is left), and t(A,C) their sum. The sum rule then says whether C is entered
    during the passage, and its verdict is taken beside where the lags of the links themselves lie.
    """
    camera_of = {zone.id: zone.camera for zone in zones}
    passages: dict[str, list[float]] = defaultdict(list)
    between = []
    for link in links:
        if link.relation == "visible":
            passages[link.to].append(link.transit.q50)
        elif camera_of[link.from_] != camera_of[link.to]:
            between.append(link)
    related: dict[tuple[str, str], PairRelation] = {}
    for link in between:
        low, high = sorted((camera_of[link.from_], camera_of[link.to]))
        lag = link.transit.q50
        meets = any(sum_rule(stay, abs(stay + lag), abs(lag), tolerance) for stay in passages[link.from_])
        if link.relation == "overlapped" or meets:
            related[low, high] = "overlapped"
        else:
            related.setdefault((low, high), "unseen_path")
    return [Pair(cameras, relation) for cameras, relation in sorted(related.items())]
