"""Topologies in formats of other programs.

`graph` reduces a topology to directed edges between cameras, which the drawing and graph formats
share: `dot` (Graphviz), `graphml`, `json_graph` (node-link JSON of networkx and D3), `svg`.
`layout` places cameras, for `svg` and for the page's map, and `large_layout` those of large sites.
`aicity` writes the AI City challenge's camera link model, `homeassistant` the MQTT messages for
Home Assistant (`Arrivals` is its memory).
"""

from __future__ import annotations

from collections.abc import Callable

from camtopod.export import homeassistant as homeassistant
from camtopod.export.aicity import camera_numbers as camera_numbers, to_aicity
from camtopod.export.arrivals import Arrivals as Arrivals, Awaited as Awaited, Passing as Passing
from camtopod.export.dot import to_dot
from camtopod.export.graph import (
    Edge as Edge,
    edges as edges,
    seconds as seconds,
    with_weak_links as with_weak_links,
)
from camtopod.export.graphml import to_graphml
from camtopod.export.json_graph import to_json_graph
from camtopod.export.layout import Place as Place, places as places
from camtopod.export.svg import to_svg
from camtopod.records import Topology

FORMATS: dict[str, Callable[[Topology], str]] = {
    "dot": to_dot,
    "graphml": to_graphml,
    "svg": to_svg,
    "json": to_json_graph,
    "aicity": to_aicity,
}
"""Function that converts a topology to text, by the format's name on the command line."""
