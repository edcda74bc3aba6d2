"""What can go wrong beside the bus (`camtopod.serve.bus.session.BusError`), and finding the place
that a name means.
"""

from __future__ import annotations

import difflib

from camtopod.records import Topology

NAMED_MAX = 20
"""So many of the cameras or zones that there are, the most alike, are named."""


class NothingLearned(LookupError):
    """There is no version of the topology yet."""

    def __init__(self) -> None:
        super().__init__(
            "nothing has been learned yet; wait_for(1, seconds) waits for the first version"
        )


class UnknownPlace(KeyError):
    """A camera or zone that this version of the topology does not have; ``str()`` says which there
    are.
    """

    def __init__(self, what: str, name: str, version: int, known: list[str]) -> None:
        alike = difflib.get_close_matches(name, known, NAMED_MAX, cutoff=0.0)
        more = f" and {len(known) - len(alike)} more" if len(known) > len(alike) else ""
        super().__init__(
            f"version {version} has no {what} {name!r}; there are {', '.join(alike) or 'none'}{more}"
        )

    def __str__(self) -> str:
        return str(self.args[0])  # a KeyError's own would be in quotation marks


def zones_of(topology: Topology, camera: str) -> list[int]:
    """Zones (indices) of a camera. Raises `UnknownPlace` for one without."""
    found = [k for k, zone in enumerate(topology.zones) if zone.camera == camera]
    if not found:
        known = list(dict.fromkeys(zone.camera for zone in topology.zones))
        raise UnknownPlace("camera", camera, topology.version, known)
    return found


def zone_at(topology: Topology, zone: str, camera: str | None = None) -> int:
    """Index of a zone, which has to be one of ``camera`` if that is given. Raises
    `UnknownPlace`.
    """
    among = range(len(topology.zones)) if camera is None else zones_of(topology, camera)
    for k in among:
        if topology.zones[k].id == zone:
            return k
    known = [topology.zones[k].id for k in among]
    raise UnknownPlace(
        "zone" if camera is None else f"zone of {camera} called", zone, topology.version, known
    )
