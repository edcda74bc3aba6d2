"""Exceptions of the client and look-up of cameras and zones by name.

Failures of the bus raise `camtopod.serve.bus.session.BusError`.
"""

from __future__ import annotations

import difflib

from camtopod.records import Topology


class NothingLearned(LookupError):
    """No version of the topology has been received yet."""

    def __init__(self) -> None:
        super().__init__(
            "nothing has been learned yet; wait_for(1, seconds) waits for the first version"
        )


class UnknownPlace(KeyError):
    """A camera or zone that this version of the topology does not have.

    ``str()`` lists up to 20 existing names, the most similar first.
    """

    def __init__(self, kind: str, name: str, version: int, names: list[str]) -> None:
        alike = ", ".join(difflib.get_close_matches(name, names, 20, cutoff=0.0)) or "none"
        super().__init__(f"version {version} has no {kind} {name!r}; there are {alike}")

    def __str__(self) -> str:
        return str(self.args[0])  # KeyError itself adds quotation marks


def zones_of(topology: Topology, camera: str) -> list[int]:
    """Return the zones (indices) of a camera. Raises `UnknownPlace` for a camera without zones."""
    rows = [k for k, zone in enumerate(topology.zones) if zone.camera == camera]
    if not rows:
        cameras = list(dict.fromkeys(zone.camera for zone in topology.zones))
        raise UnknownPlace("camera", camera, topology.version, cameras)
    return rows


def zone_at(topology: Topology, zone: str, camera: str | None = None) -> int:
    """Return the index of a zone; with ``camera``, only zones of that camera are searched.

    Raises `UnknownPlace`.
    """
    rows = [
        k for k, camera_zone in enumerate(topology.zones) if camera in (None, camera_zone.camera)
    ]
    for k in rows:
        if topology.zones[k].id == zone:
            return k
    if camera is not None:
        zones_of(topology, camera)  # raises for an unknown camera
    ids = [topology.zones[k].id for k in rows]
    kind = "zone" if camera is None else f"zone of {camera} called"
    raise UnknownPlace(kind, zone, topology.version, ids)
