"""Topologies in formats of other programs.

`graph` reduces a topology to directed edges between cameras, which the drawing and graph formats
share: `dot` (Graphviz), `graphml`, `json_graph` (node-link JSON of networkx and D3), `svg`; all are
in `formats`. `layout` places cameras, for the `drawing` and for the page's map, and `large_layout`
those of large sites. `aicity` writes the AI City challenge's camera link model, `homeassistant` the
MQTT messages for Home Assistant (`ExpectedArrivals` is its memory).
"""

from __future__ import annotations

from camtopod.export import homeassistant as homeassistant
from camtopod.export.aicity import camera_numbers as camera_numbers
from camtopod.export.arrivals import (
    Awaited as Awaited,
    ExpectedArrivals as ExpectedArrivals,
    Passing as Passing,
)
from camtopod.export.drawing import draw as draw
from camtopod.export.formats import FORMATS as FORMATS, export_topology as export_topology
from camtopod.export.graph import Edge as Edge, edges as edges, seconds as seconds
from camtopod.export.layout import Place as Place, places as places
