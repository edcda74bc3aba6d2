"""Exceptions of the client and look-up of cameras and zones by name.

Failures of the bus raise `camtopod.serve.bus.session.BusError`.
"""

from __future__ import annotations

import difflib

from camtopod.records import Topology

NAMED_MAX = 20
"""Number of existing cameras or zones that an error message lists; the most similar are chosen."""


class NothingLearned(LookupError):
    """No version of the topology has been received yet."""

    def __init__(self) -> None:
        super().__init__(
            "nothing has been learned yet; wait_for(1, seconds) waits for the first version"
        )


class UnknownPlace(KeyError):
    """A camera or zone that this version of the topology does not have.

    ``str()`` lists existing names, the most similar first.
    """

    def __init__(self, what: str, name: str, version: int, known: list[str]) -> None:
        alike = difflib.get_close_matches(name, known, NAMED_MAX, cutoff=0.0)
        more = f" and {len(known) - len(alike)} more" if len(known) > len(alike) else ""
        super().__init__(
            f"version {version} has no {what} {name!r}; "
            f"there are {', '.join(alike) or 'none'}{more}"
        )

    def __str__(self) -> str:
        return str(self.args[0])  # KeyError itself adds quotation marks


def zones_of(topology: Topology, camera: str) -> list[int]:
    """Return the zones (indices) of a camera. Raises `UnknownPlace` for a camera without zones."""
    found = [k for k, zone in enumerate(topology.zones) if zone.camera == camera]
    if not found:
        known = list(dict.fromkeys(zone.camera for zone in topology.zones))
        raise UnknownPlace("camera", camera, topology.version, known)
    return found


def zone_at(topology: Topology, zone: str, camera: str | None = None) -> int:
    """Return the index of a zone; with ``camera``, only zones of that camera are searched.

    Raises `UnknownPlace`.
    """
    what = "zone"
    among = list(range(len(topology.zones)))
    if camera is not None:
        what = f"zone of {camera} called"
        among = zones_of(topology, camera)
    for k in among:
        if topology.zones[k].id == zone:
            return k
    known = [topology.zones[k].id for k in among]
    raise UnknownPlace(what, zone, topology.version, known)
