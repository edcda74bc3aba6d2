"""Topologies in formats of other programs.

`graph` reduces a topology to directed edges between cameras, which the drawing and graph formats
share: `dot` (Graphviz), `graphml`, `nodelink` (JSON of D3 and networkx), `mermaid`, `svg`. `layout`
places cameras, for `svg` and for the page's map. `aicity` writes the AI City challenge's camera
link model, `homeassistant` the MQTT messages for Home Assistant.
"""

from __future__ import annotations

from collections.abc import Callable

from camtopod.export import homeassistant
from camtopod.export.aicity import camera_numbers, to_aicity
from camtopod.export.dot import to_dot
from camtopod.export.graph import Edge, edges
from camtopod.export.graphml import to_graphml
from camtopod.export.layout import Place, places
from camtopod.export.mermaid import to_mermaid
from camtopod.export.nodelink import to_nodelink
from camtopod.export.svg import to_svg
from camtopod.records import Topology

FORMATS: dict[str, Callable[[Topology], str]] = {
    "dot": to_dot,
    "graphml": to_graphml,
    "svg": to_svg,
    "mermaid": to_mermaid,
    "json": to_nodelink,
    "aicity": to_aicity,
}
"""Function that converts a topology to text, by the format's name on the command line."""

__all__ = ["FORMATS", "Edge", "Place", "camera_numbers", "edges", "homeassistant", "places"]
