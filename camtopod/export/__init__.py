"""A topology in the formats of other programs."""

from __future__ import annotations

from collections.abc import Callable

from camtopod.export import homeassistant
from camtopod.export.aicity import camera_numbers, to_aicity
from camtopod.export.dot import to_dot
from camtopod.export.graph import Edge, edges
from camtopod.export.graphml import to_graphml
from camtopod.export.nodelink import to_nodelink
from camtopod.export.svg import to_svg
from camtopod.records import Topology

FORMATS: dict[str, Callable[[Topology], str]] = {
    "dot": to_dot,
    "graphml": to_graphml,
    "svg": to_svg,
    "json": to_nodelink,
    "aicity": to_aicity,
}
"""Name on the command line -> topology to text."""

__all__ = ["FORMATS", "Edge", "camera_numbers", "edges", "homeassistant"]
