"""The network at the level of cameras: what every format draws."""

from __future__ import annotations

from msgspec import Struct

from camtopod.records import Link, Topology, Transit

BLACK, GREY = "black", "gray60"
"""The thesis's colours (4.6): overlapping views, and paths that nobody sees."""


class Edge(Struct, frozen=True):
    """From one camera to the next. The times are those of the most walked link, of an overlapped
    one if any.

    ``probability``: of all objects that leave ``from_``'s view, the share that appears next in
    ``to``'s.
    """

    from_: str
    to: str
    overlapped: bool
    transit: Transit
    probability: float
    transitions: float

    @property
    def colour(self) -> str:
        """As the thesis draws it: `BLACK` or `GREY`."""
        return BLACK if self.overlapped else GREY


def edges(topology: Topology) -> list[Edge]:
    """Directed edges between cameras, by their links; sorted by camera ids."""
    camera = {zone.id: zone.camera for zone in topology.zones}
    exits: dict[str, int] = {}
    for zone in topology.zones:
        exits[zone.camera] = exits.get(zone.camera, 0) + zone.exits
    grouped: dict[tuple[str, str], list[Link]] = {}
    for link in topology.links:
        if link.relation != "visible" and camera[link.from_] != camera[link.to]:
            grouped.setdefault((camera[link.from_], camera[link.to]), []).append(link)
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
    """A time for a label: at most a tenth of a second, as nobody reads more."""
    return f"{value:.1f} s" if abs(value) < 10 else f"{value:.0f} s"
