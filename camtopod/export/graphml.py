"""GraphML, for Gephi, yEd, Cytoscape and networkx."""

from __future__ import annotations

from xml.etree import ElementTree

from camtopod.export.graph import edges
from camtopod.records import Topology
from camtopod.visible import visible

NAMESPACE = "http://graphml.graphdrawing.org/xmlns"
_NODE = {"zones": "int", "clock_offset": "double"}
_EDGE = {
    "relation": "string",
    "colour": "string",
    "weight": "double",
    "mean": "double",
    "sd": "double",
    "q10": "double",
    "q50": "double",
    "q90": "double",
    "probability": "double",
    "transitions": "double",
}


def to_graphml(topology: Topology) -> str:
    """Return a directed graph of cameras; edge weights are modes of transit times, seconds."""
    root = ElementTree.Element("graphml", xmlns=NAMESPACE)

    # Declare the attributes.
    for target, keys in (("node", _NODE), ("edge", _EDGE)):
        for name, kind in keys.items():
            key = {"id": f"{target}_{name}", "for": target, "attr.name": name, "attr.type": kind}
            ElementTree.SubElement(root, "key", key)

    # Nodes.
    graph = ElementTree.SubElement(root, "graph", id=visible(topology.site), edgedefault="directed")
    for camera in topology.cameras:
        node = ElementTree.SubElement(graph, "node", id=visible(camera.id))
        _data(node, "node", {"zones": len(camera.zones), "clock_offset": camera.clock_offset})

    # Edges.
    for edge in edges(topology):
        element = ElementTree.SubElement(
            graph, "edge", source=visible(edge.from_), target=visible(edge.to)
        )
        values = {
            "relation": edge.relation,
            "colour": edge.colour,
            "weight": edge.transit.mode,
            **{name: getattr(edge.transit, name) for name in ("mean", "sd", "q10", "q50", "q90")},
            "probability": edge.probability,
            "transitions": edge.transitions,
        }
        _data(element, "edge", values)
    ElementTree.indent(root)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        + ElementTree.tostring(root, encoding="unicode")
        + "\n"
    )


def _data(element: ElementTree.Element, target: str, values: dict[str, object]) -> None:
    for name, value in values.items():
        ElementTree.SubElement(element, "data", key=f"{target}_{name}").text = str(value)
