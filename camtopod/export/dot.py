"""Graphviz (DOT)."""

from __future__ import annotations

from camtopod.export.graph import COLOURS, edges, seconds
from camtopod.records import Topology
from camtopod.visible import visible


def to_dot(topology: Topology) -> str:
    """Return a directed graph of cameras, labelled with transit times.

    Edges between overlapping views are black, unseen paths grey, weak links dashed.
    """
    lines = [
        "digraph camtopod {",
        f"  label={_quoted(f'{topology.site}, version {topology.version}')};",
        "  node [shape=box, style=rounded];",
    ]

    # Nodes.
    for camera in topology.cameras:
        label = f"{_escaped(camera.id)}\\nzones: {len(camera.zones)}"
        lines.append(f'  {_quoted(camera.id)} [label="{label}"];')

    # Edges.
    for edge in edges(topology):
        attributes = {
            "color": COLOURS[edge.relation],
            "label": seconds(edge.transit.mode),
            "weight": str(round(100 * edge.probability)),
            "penwidth": f"{1 + 3 * edge.probability:.2f}",
            "tooltip": f"{edge.transit.q10:.1f} to {edge.transit.q90:.1f} s, "
            f"{100 * edge.probability:.0f} %",
        }
        if edge.weak:
            attributes["style"] = "dashed"
        text = ", ".join(f"{name}={_quoted(value)}" for name, value in attributes.items())
        lines.append(f"  {_quoted(edge.from_)} -> {_quoted(edge.to)} [{text}];")
    return "\n".join([*lines, "}", ""])


def _quoted(text: str) -> str:
    return f'"{_escaped(text)}"'


def _escaped(text: str) -> str:
    return visible(text).replace("\\", "\\\\").replace('"', '\\"')
