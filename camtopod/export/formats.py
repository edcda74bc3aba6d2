"""The formats of other programs in which a topology can be written."""

from __future__ import annotations

import os
from collections.abc import Callable

from camtopod.codec import require_topology
from camtopod.export.aicity import to_aicity
from camtopod.export.dot import to_dot
from camtopod.export.graph import with_weak_links
from camtopod.export.graphml import to_graphml
from camtopod.export.json_graph import to_json_graph
from camtopod.export.svg import to_svg
from camtopod.files import writing
from camtopod.records import Topology

FORMATS: dict[str, Callable[[Topology], str]] = {
    "dot": to_dot,
    "graphml": to_graphml,
    "svg": to_svg,
    "json": to_json_graph,
    "aicity": to_aicity,
}
"""Function that converts a topology to text, by the format's name on the command line."""


def export_topology(
    topology: Topology, format: str, path: str | os.PathLike[str] | None = None, weak: bool = False
) -> str:
    """Return a topology as text in a format of other programs; write it to a file if one is named.

        >>> from camtopod import export_topology, load_topology
        >>> text = export_topology(load_topology("topology.json"), "graphml", "network.graphml")
        >>> text[:38]
        '<?xml version="1.0" encoding="UTF-8"?>'

    format: one of `FORMATS`.
    weak: with the links that have half of their evidence.

    Raises ValueError for another format, OSError if the file cannot be written; TypeError.
    """
    require_topology(topology)
    if format not in FORMATS:
        raise ValueError(f"no format {format!r}; there are {', '.join(FORMATS)}")
    text = FORMATS[format](with_weak_links(topology) if weak else topology)
    if path is not None:
        with writing(os.fspath(path)) as file:
            file.write(text.encode())
    return text
