"""Data of a report: everything that the page would query from the server, gathered beforehand."""

from __future__ import annotations

import base64
import mimetypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from camtopod.config import Config
from camtopod.records import Link, Topology
from camtopod.topology import weak_links
from camtopod.web.explanations import Explanations
from camtopod.web.growth import step, thinned
from camtopod.web.map_data import draw
from camtopod.web.pictures import picture_of
from camtopod.web.versions import summary

LINKS_MAX = 3_000
"""Links with full details, those with most transitions first.

A browser cannot open the links of a large site in one file.
"""


def gather(
    topology: Topology,
    older: Sequence[Topology],
    pictures: Path | None,
    config: Config | None = None,
) -> dict[str, Any]:
    """Return the data of a report on ``topology``: the server's answers, by query. Raises OSError.

    older: earlier versions, oldest first.
    pictures: folder of camera pictures.
    config: with the floor plan, if there is one.
    """
    plan = Path(config.map.plan) if config is not None and config.map.plan else None
    site_map = draw(topology)
    explanations = Explanations(topology)
    cameras = [camera.id for camera in topology.cameras]
    files = {name: path for name in cameras if (path := picture_of(pictures, name)) is not None}
    versions = [*older, topology]
    return {
        "map": site_map,
        "cameras": {
            name: {**(explanations.camera(name) or {}), "picture": name in files}
            for name in cameras
        },
        "pairs": {key: explanations.pair(*key.split(" ")) for key in site_map.edges},
        "links": {
            f"{link.from_} {link.to} {link.relation}": explanations.link(
                link.from_, link.to, link.relation
            )
            for link in _explained(topology)
        },
        "versions": [
            summary(version, before)
            for before, version in zip([None, *older], versions, strict=True)
        ],
        "growth": [step(version) for version in thinned(versions)],
        "pictures": {name: _data_url(path) for name, path in files.items()},
        "plan": plan and config and {"href": _data_url(plan), "at": placed(config)},
    }


def placed(config: Config) -> dict[str, tuple[float, ...]]:
    """Return the places of the cameras on the floor plan."""
    return {name: camera.at for name, camera in config.cameras.items() if camera.at}


def _data_url(path: Path) -> str:
    kind = mimetypes.guess_type(path.name)[0]
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"


def _explained(topology: Topology) -> list[Link]:
    """Return the links with full details, links between views before those within one."""
    camera = {zone.id: zone.camera for zone in topology.zones}
    links = [
        *topology.links,
        *(link for link in weak_links(topology) if camera[link.from_] != camera[link.to]),
    ]
    links.sort(
        key=lambda link: (link.relation == "visible", link.q_value > 0.05, -link.transitions)
    )
    return links[:LINKS_MAX]
