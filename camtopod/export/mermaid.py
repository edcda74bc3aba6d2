"""Mermaid, which Markdown pages draw: a fenced block with the language ``mermaid``."""

from __future__ import annotations

from camtopod.export.graph import edges, seconds
from camtopod.records import Topology
from camtopod.visible import visible


def to_mermaid(topology: Topology) -> str:
    """Return a flowchart of the cameras.

    Overlapping views are joined by a thick line, unseen paths by arrows with their most frequent
    transit times.
    """
    # Nodes; their names in the text are numbers, as ids may be words of the language.
    number = {camera.id: f"c{k}" for k, camera in enumerate(topology.cameras)}
    lines = ["flowchart LR", *(f'  {number[id_]}(["{_escaped(id_)}"])' for id_ in number)]

    # Edges: overlaps once, paths in each direction.
    overlapping = set()
    for edge in edges(topology):
        a, b = number[edge.from_], number[edge.to]
        if not edge.overlapped:
            lines.append(f'  {a} -->|"{seconds(edge.transit.mode)}"| {b}')
        elif (b, a) not in overlapping:
            overlapping.add((a, b))
            lines.append(f"  {a} === {b}")
    return "\n".join([*lines, ""])


def _escaped(text: str) -> str:
    """Return a text for a quoted label; Mermaid reads ``#`` as the beginning of an entity."""
    return visible(text).replace("#", "#35;").replace('"', "#quot;").replace("<", "#lt;")
