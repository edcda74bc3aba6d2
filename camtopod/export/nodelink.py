"""Node-link JSON, for D3 and networkx. (A topology is JSON already: see `camtopod.records`.)"""

from __future__ import annotations

from typing import Any

import msgspec

from camtopod.export.graph import edges
from camtopod.records import Topology


def to_nodelink(topology: Topology) -> str:
    """Return a directed graph of cameras with their zones.

    Edge weights are modes of transit times, seconds.
    """
    zones = {zone.id: zone for zone in topology.zones}
    graph: dict[str, Any] = {
        "directed": True,
        "multigraph": False,
        "graph": {
            name: getattr(topology, name)
            for name in ("site", "epoch", "version", "as_of", "digest")
        },
        "nodes": [
            {
                "id": camera.id,
                "clock_offset": camera.clock_offset,
                "zones": [zones[z] for z in camera.zones],
            }
            for camera in topology.cameras
        ],
        "links": [
            {
                "source": edge.from_,
                "target": edge.to,
                "relation": "overlapped" if edge.overlapped else "unseen_path",
                "colour": edge.colour,
                "weight": edge.transit.mode,
                "transit": edge.transit,
                "probability": edge.probability,
                "transitions": edge.transitions,
                **({"operator": edge.operator} if edge.operator else {}),
            }
            for edge in edges(topology)
        ],
    }
    return msgspec.json.format(msgspec.json.encode(graph), indent=2).decode() + "\n"
