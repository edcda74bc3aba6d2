"""GraphML, for Gephi, yEd, Cytoscape and networkx."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

from camtopod.export.graph import COLOURS, edges
from camtopod.records import Topology
from camtopod.visible import visible

NAMESPACE = "http://graphml.graphdrawing.org/xmlns"
_TYPES = {int: "int", float: "double", str: "string", bool: "boolean"}
"""Type of an attribute by that of its values."""


def to_graphml(topology: Topology) -> str:
    """Return a directed graph of cameras; edge weights are transit times, seconds."""
    root = ElementTree.Element("graphml", xmlns=NAMESPACE)
    graph = ElementTree.Element("graph", id=visible(topology.site), edgedefault="directed")
    keys: dict[str, ElementTree.Element] = {}

    def add(target: str, names: dict[str, str], values: Mapping[str, int | float | str]) -> None:
        """Add a node or an edge with its attributes, and declare these."""
        element = ElementTree.SubElement(graph, target, names)
        for name, value in values.items():
            key = {"id": f"{target}_{name}", "for": target, "attr.name": name}
            key["attr.type"] = _TYPES[type(value)]
            keys.setdefault(key["id"], ElementTree.Element("key", key))
            text = str(value).lower() if isinstance(value, bool) else str(value)
            ElementTree.SubElement(element, "data", key=key["id"]).text = text

    # Nodes and edges.
    for camera in topology.cameras:
        values = {"zones": len(camera.zones), "clock_offset": float(camera.clock_offset)}
        add("node", {"id": visible(camera.id)}, values)
    for edge in edges(topology):
        names = ("mean", "sd", "mode", "q10", "q50", "q90")
        figures = {name: getattr(edge.transit, name) for name in names}
        add(
            "edge",
            {"source": visible(edge.from_), "target": visible(edge.to)},
            {
                "relation": edge.relation,
                "colour": COLOURS[edge.relation],
                "weight": edge.weight,
                **figures,
                "probability": edge.probability,
                "transitions": edge.transitions,
                "weak": edge.weak,
            },
        )
    root.extend([*keys.values(), graph])
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
