"""Data of a report: everything that the page would query from the server, gathered beforehand."""

from __future__ import annotations

import base64
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from camtopod.records import Link, Topology
from camtopod.web.explanations import Explanations
from camtopod.web.map_data import draw
from camtopod.web.pictures import TYPES, picture_of
from camtopod.web.versions import summary

LINKS_MAX = 3_000
"""Links with full details, those with most transitions first.

A browser cannot open the links of a large site in one file.
"""
Count = Callable[[int, int], None]
"""Progress callback: parts that are ready, and their total number."""
_T = TypeVar("_T")


def gather(
    topology: Topology,
    older: Sequence[Topology],
    pictures: Path | None,
    count: Count = lambda done, of: None,
) -> dict[str, Any]:
    """Return the data of a report on ``topology``. Raises OSError.

    older: earlier versions, oldest first.
    pictures: folder of camera pictures.
    count: called often, with the number of parts that are ready and their total number.
    """
    # What the report covers.
    drawn = draw(topology)
    cameras = [camera.id for camera in topology.cameras]
    files = {
        camera: path for camera in cameras if (path := picture_of(pictures, camera)) is not None
    }
    explanations = Explanations(topology)
    versions = [*older, topology]
    links = _explained(topology)

    # Progress.
    ready = itertools.count()
    parts = len(cameras) + len(drawn.edges) + len(links) + len(versions)

    def counted(part: _T) -> _T:
        count(next(ready), parts)
        return part

    # The answers of the server, by query.
    return {
        "map": drawn,
        "cameras": {
            name: {**(explanations.camera(counted(name)) or {}), "picture": name in files}
            for name in cameras
        },
        "pairs": {key: explanations.pair(*counted(key).split(" ")) for key in drawn.edges},
        "links": {
            f"{link.from_} {link.to} {link.relation}": explanations.link(
                link.from_, link.to, link.relation
            )
            for link in map(counted, links)
        },
        "versions": [
            summary(counted(one), before)
            for before, one in zip([None, *versions[:-1]], versions, strict=True)
        ],
        "pictures": {name: _inline(path) for name, path in files.items()},
    }


def _explained(topology: Topology) -> list[Link]:
    """Return the links with full details, links between views before those within one."""
    camera = {zone.id: zone.camera for zone in topology.zones}
    links = [
        *topology.links,
        *(link for link in topology.weak_links or [] if camera[link.from_] != camera[link.to]),
    ]
    links.sort(
        key=lambda link: (link.relation == "visible", link.q_value > 0.05, -link.transitions)
    )
    return links[:LINKS_MAX]


def _inline(path: Path) -> str:
    """Return a picture as a data URL."""
    return f"data:{TYPES[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"
