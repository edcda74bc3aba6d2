"""Camera-level graph of a topology, from which all graph formats are made."""

from __future__ import annotations

from collections import Counter, defaultdict

from msgspec import Struct
from msgspec.structs import replace

from camtopod.records import Link, PairRelation, Topology, Transit
from camtopod.topology import (
    RELATIONS,
    camera_of,
    likely_links,
    link_key,
    links_between_views,
    weak_links,
)

COLOURS: dict[PairRelation, str] = {"overlapped": "black", "unseen_path": "gray60"}
"""Colour of an edge by the relation of its cameras, as in the thesis (4.6)."""
WEIGHT_SECONDS_MIN = 0.1
"""Least weight of an edge; views that overlap have times around zero."""


class Edge(Struct, frozen=True, omit_defaults=True, rename={"from_": "from"}):
    """Directed edge between two cameras."""

    from_: str
    to: str
    relation: PairRelation
    """Overlapped if one of its links joins overlapping views."""
    transit: Transit
    """Transit time of the link with most transitions, among overlapped ones if there are any."""
    probability: float
    """Share of all objects leaving the view of ``from_`` that appear next in the view of ``to``."""
    transitions: float
    """Expected number of transitions of all its links."""
    weak: bool = False
    """Whether its links are weak ones, which are not published."""

    @property
    def weight(self) -> float:
        """Most frequent transit time, seconds, as a weight: positive, as algorithms want it."""
        return max(self.transit.mode, WEIGHT_SECONDS_MIN)

    @property
    def overlapped(self) -> bool:
        """Whether the views of the two cameras overlap."""
        return self.relation == "overlapped"


def edges(topology: Topology) -> list[Edge]:
    """Return the directed edges between cameras, sorted by camera ids."""
    weak = {link_key(link) for link in weak_links(topology)}
    camera = {zone.id: zone.camera for zone in topology.zones}
    exits = Counter[str]()
    for zone in topology.zones:
        exits[zone.camera] += zone.exits

    # Links between different cameras, by pair of cameras.
    groups: dict[tuple[str, str], list[Link]] = defaultdict(list)
    for link in links_between_views(topology):
        groups[camera[link.from_], camera[link.to]].append(link)

    # One edge per pair, with the times of its main link.
    result = []
    for (a, b), links in sorted(groups.items()):
        chief = max(links, key=lambda x: (x.relation == "overlapped", x.transitions, x.from_, x.to))
        relation = RELATIONS[chief.relation == "overlapped"]
        transitions = sum(link.transitions for link in links)
        probability = min(1.0, transitions / max(exits[a], 1))
        is_weak = link_key(chief) in weak
        result.append(Edge(a, b, relation, chief.transit, probability, transitions, is_weak))
    return result


def with_weak_links(topology: Topology) -> Topology:
    """Return a topology to draw, with the likely links of cameras that no published link joins."""
    pairs = {(camera_of(link.from_), camera_of(link.to)) for link in topology.links}
    weak = [
        link
        for link in likely_links(topology)
        if (camera_of(link.from_), camera_of(link.to)) not in pairs
    ]
    return replace(topology, links=[*topology.links, *weak])


def seconds(value: float) -> str:
    """Return a time for a label, with a tenth of a second at most."""
    if abs(value) < 10:
        return f"{value:.1f} s"
    return f"{value:.0f} s"
