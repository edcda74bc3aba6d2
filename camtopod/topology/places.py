"""Look-up of cameras and zones by name."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from camtopod.records import Zone


class UnknownPlace(KeyError):
    """A camera or zone that this version of the topology does not have.

    ``str()`` lists up to 20 existing names, the most similar first.
    """

    def __init__(self, kind: str, name: str, version: int, names: list[str]) -> None:
        alike = ", ".join(difflib.get_close_matches(name, names, 20, cutoff=0.0)) or "none"
        super().__init__(f"version {version} has no {kind} {name!r}; there are {alike}")

    def __str__(self) -> str:
        return str(self.args[0])  # KeyError itself adds quotation marks


def zones_of(version: int, zones: Sequence[Zone], camera: str) -> list[int]:
    """Return the indices of a camera's zones.

    version, zones: number and zones of a version of the topology.

    Raises `UnknownPlace` for a camera without zones.
    """
    rows = [k for k, zone in enumerate(zones) if zone.camera == camera]
    if not rows:
        cameras = list(dict.fromkeys(zone.camera for zone in zones))
        raise UnknownPlace("camera", camera, version, cameras)
    return rows


def zone_at(version: int, zones: Sequence[Zone], zone_id: str, camera: str | None = None) -> int:
    """Return the index of a zone; with ``camera``, only zones of that camera are searched.

    version, zones: as for `zones_of`.

    Raises `UnknownPlace`.
    """
    rows = range(len(zones)) if camera is None else zones_of(version, zones, camera)
    for k in rows:
        if zones[k].id == zone_id:
            return k
    kind = "zone" if camera is None else f"zone of {camera} called"
    raise UnknownPlace(kind, zone_id, version, [zones[k].id for k in rows])
