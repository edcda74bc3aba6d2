"""Camera-level graph of a topology, from which all graph formats are made."""

from __future__ import annotations

from msgspec import Struct

from camtopod.records import Link, PairRelation, Topology, Transit

BLACK = "black"
"""Colour of overlapping views in the thesis (4.6)."""
GREY = "gray60"
"""Colour of paths that no camera sees."""


class Edge(Struct, frozen=True):
    """Directed edge between two cameras."""

    from_: str
    to: str
    overlapped: bool
    """True if one of its links joins overlapping views."""
    transit: Transit
    """Transit time of the link with most transitions, among overlapped ones if there are any."""
    probability: float
    """Share of all objects leaving the view of ``from_`` that appear next in the view of ``to``."""
    transitions: float
    """Expected number of transitions of all its links."""

    @property
    def relation(self) -> PairRelation:
        """Relation of the two cameras."""
        return "overlapped" if self.overlapped else "unseen_path"

    @property
    def colour(self) -> str:
        """Colour in the thesis: `BLACK` or `GREY`."""
        return BLACK if self.overlapped else GREY


def edges(topology: Topology) -> list[Edge]:
    """Return the directed edges between cameras, sorted by camera ids."""
    camera = {zone.id: zone.camera for zone in topology.zones}
    exits: dict[str, int] = {}
    for zone in topology.zones:
        exits[zone.camera] = exits.get(zone.camera, 0) + zone.exits

    # Links between different cameras, by pair of cameras.
    grouped: dict[tuple[str, str], list[Link]] = {}
    for link in topology.links:
        if link.relation != "visible" and camera[link.from_] != camera[link.to]:
            grouped.setdefault((camera[link.from_], camera[link.to]), []).append(link)

    # One edge per pair, with the times of its main link.
    result = []
    for (a, b), links in sorted(grouped.items()):
        transitions = sum(link.transitions for link in links)
        overlapping = [link for link in links if link.relation == "overlapped"]
        chief = max(overlapping or links, key=lambda link: (link.transitions, link.from_, link.to))
        result.append(
            Edge(
                from_=a,
                to=b,
                overlapped=bool(overlapping),
                transit=chief.transit,
                probability=min(1.0, transitions / exits[a]) if exits[a] else 0.0,
                transitions=transitions,
            )
        )
    return result


def seconds(value: float) -> str:
    """Return a time for a label, with a tenth of a second at most."""
    return f"{value:.1f} s" if abs(value) < 10 else f"{value:.0f} s"
