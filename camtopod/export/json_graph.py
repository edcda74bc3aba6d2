"""Node-link JSON, for networkx and D3. (A topology is JSON already: see `camtopod.records`.)"""

from __future__ import annotations

import msgspec

from camtopod.export.graph import COLOURS, edges
from camtopod.records import Topology

_ABOUT = ("site", "epoch", "version", "as_of", "digest")


def to_json_graph(topology: Topology) -> str:
    """Return a directed graph of cameras with their zones.

    Edge weights are transit times, seconds.
    """
    zones = {zone.id: zone for zone in topology.zones}
    nodes = [
        {
            "id": camera.id,
            "clock_offset": camera.clock_offset,
            "zones": [zones[zone] for zone in camera.zones],
        }
        for camera in topology.cameras
    ]
    rows = [
        {
            "source": edge.from_,
            "target": edge.to,
            "relation": edge.relation,
            "colour": COLOURS[edge.relation],
            "weight": edge.weight,
            "transit": edge.transit,
            "probability": edge.probability,
            "transitions": edge.transitions,
            "weak": edge.weak,
        }
        for edge in edges(topology)
    ]
    graph = {
        "directed": True,
        "multigraph": False,
        "graph": {name: getattr(topology, name) for name in _ABOUT},
        "nodes": nodes,
        "edges": rows,
    }
    return msgspec.json.format(msgspec.json.encode(graph), indent=2).decode() + "\n"
