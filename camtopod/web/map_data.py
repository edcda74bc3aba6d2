"""Map for the page: cameras with positions, and an edge per related pair."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from msgspec import Struct
from msgspec.structs import replace

from camtopod.export import Edge, Place, edges, places
from camtopod.records import Link, Pair, PairRelation, Topology
from camtopod.topology import RELATIONS, lacks_in_words, likely_links, waiting_for_links
from camtopod.words import AlarmWords, alarms_in_words

SETTLED_TRANSITIONS_MIN = 30.0
"""Transitions below which an edge is provisional.

With fewer, the standard error of its median transit time is more than a fifth of the spread.
"""


class MapCamera(Struct, frozen=True):
    """A node; ``x`` and ``y`` as in `camtopod.export.layout.places`."""

    x: float
    y: float
    zones: int
    entries: int
    exits: int
    new: bool = False
    """True if the camera is on the site, and not in the version yet."""


class MapEdge(Struct, frozen=True):
    """A related pair of cameras."""

    relation: PairRelation
    provisional: str
    """Why the edge is provisional; "" if it is settled."""
    published: bool
    """False for an edge of weak links only."""
    transitions: float
    ways: list[Edge]


class Map(Struct, frozen=True):
    """All data of the map of one version."""

    site: str
    epoch: str
    version: int
    as_of: float
    cameras: dict[str, MapCamera]
    edges: dict[str, MapEdge]
    """By the two camera ids, sorted and separated by a space."""
    alarms: list[AlarmWords]
    """Newest first."""
    waiting: str
    """Missing evidence for the first link between views, in words; "" if there is a link."""


NO_MAP = Map("", "", 0, 0.0, {}, {}, [], "")
"""The map before anything has been learned."""


def draw(topology: Topology | None, before: Map = NO_MAP, new: Iterable[str] = ()) -> Map:
    """Return the map of a version; None: before the first one, of the ``new`` cameras alone.

    before: the previous map, whose camera positions are kept as far as the network is the same.
    new: cameras of the site that are not in the version yet.
    """
    if topology is None:
        at = _places(sorted(new), {}, before)
        return replace(before, cameras={name: _new_camera(at[name]) for name in sorted(at)})

    # Edges and counts of events.
    pair_edges = map_edges(topology)
    entries = dict.fromkeys((camera.id for camera in topology.cameras), 0)
    exits = entries.copy()
    for zone in topology.zones:
        entries[zone.camera] += zone.entries
        exits[zone.camera] += zone.exits

    # Nodes.
    new = set(new) - entries.keys()
    at = _places([*entries, *new], pair_edges, before)
    cameras = {
        camera.id: MapCamera(
            *at[camera.id], len(camera.zones), entries[camera.id], exits[camera.id]
        )
        for camera in topology.cameras
    }
    cameras |= {name: _new_camera(at[name]) for name in sorted(new)}
    return Map(
        topology.site,
        topology.epoch,
        topology.version,
        topology.as_of,
        cameras,
        pair_edges,
        alarms_in_words(topology),
        waiting_for_links(topology),
    )


def _new_camera(place: Place) -> MapCamera:
    return MapCamera(*place, 0, 0, 0, new=True)


def map_edges(topology: Topology) -> dict[str, MapEdge]:
    """Return the published pairs, and those with at least half of the evidence."""
    camera = {zone.id: zone.camera for zone in topology.zones}
    ways: dict[str, list[Edge]] = {}
    best: dict[str, Link] = {}

    # Directions of each pair, from published links first, and the link nearest to publication.
    pairs = {_key(*pair.cameras): pair for pair in topology.pairs}
    for published, links in ((True, topology.links), (False, likely_links(topology))):
        earlier_keys = set(ways)
        for edge in edges(replace(topology, links=links, pairs=[])):
            key = _key(edge.from_, edge.to)
            if published or key not in earlier_keys:
                ways.setdefault(key, []).append(edge)
        for link in links:
            key = _key(camera[link.from_], camera[link.to])
            best[key] = min(best.get(key, link), link, key=nearness)

    # One edge per pair.
    result = {}
    for key in sorted({*ways, *pairs}):
        directions = ways.get(key, [])
        transitions = sum(way.transitions for way in directions)
        pair = pairs.get(key)
        relation = RELATIONS[any(way.overlapped for way in directions)]
        result[key] = MapEdge(
            pair.relation if pair else relation,
            why_provisional(pair, transitions, best.get(key)),
            pair is not None,
            transitions,
            directions,
        )
    return result


def nearness(link: Link) -> tuple[float, float]:
    """Return a sort key: the nearer a link is to publication, the smaller."""
    return (math.inf if link.lacks is None else link.lacks.seconds), link.q_value


def why_provisional(pair: Pair | None, transitions: float, best: Link | None) -> str:
    """Return why an edge is provisional, in words; "" if it is settled.

    best: the link that is nearest to publication.
    """
    if best is not None and best.provisional:
        return best.provisional
    if pair is None:
        if best is not None and best.lacks is not None:
            return f"not published yet: it lacks {lacks_in_words(best.lacks)}"
        return "not published: not all rules for publishing are met yet"
    if transitions < SETTLED_TRANSITIONS_MIN:
        return f"new: only about {transitions:.0f} transitions are known"
    if None not in (pair.by_lags, pair.by_sum_rule) and pair.by_lags != pair.by_sum_rule:
        reason = f" ({pair.reason})" if pair.reason else ""
        return f"the two tests of its relation disagree{reason}"
    return ""


def _places(names: list[str], pair_edges: Mapping[str, MapEdge], before: Map) -> dict[str, Place]:
    """Return the camera positions; those of before if the network is the same."""
    layout_edges = _joined(pair_edges)
    positions = {name: (camera.x, camera.y) for name, camera in before.cameras.items()}
    if layout_edges == _joined(before.edges) and set(names) == set(positions):
        return positions
    return places(names, layout_edges, positions)


def _joined(pair_edges: Mapping[str, MapEdge]) -> dict[tuple[str, str], bool]:
    """Return the edges that determine the layout, with whether views overlap."""
    result = {}
    for key, edge in pair_edges.items():
        if edge.published:
            a, b = key.split(" ")
            result[a, b] = edge.relation == "overlapped"
    return result


def _key(a: str, b: str) -> str:
    return " ".join(sorted((a, b)))
