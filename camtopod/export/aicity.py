"""The AI City challenge's camera link model: ``camera_transitions.txt`` of the UWIPL team's code
(2019).

One line a transition, eight fields with a space between: camera and zone lists of the one side,
those of the other, the two zones between which the time counts, and the smallest and largest time
in frames. Cameras and zones are integers; the lower camera number comes first and times run from
there, so objects that go the other way have negative times. A zone list is the zones of one
passage, ``3-1``; semicolons part alternatives.
"""

from __future__ import annotations

import math
import re

from camtopod.records import Link, Topology

FRAMES_PER_SECOND = 10.0
"""The challenge's videos."""


def to_aicity(topology: Topology) -> str:
    """Links between cameras as transition lines; the time window is the learned q10 to q90."""
    numbers = camera_numbers(topology)
    camera = {zone.id: zone.camera for zone in topology.zones}
    through = [link for link in topology.links if link.relation == "visible"]
    lines = []
    for link in topology.links:
        if link.relation == "visible" or camera[link.from_] == camera[link.to]:
            continue
        leaving = (
            numbers[camera[link.from_]],
            _passages(through, link.from_, leaves=True),
            link.from_,
        )
        coming = (numbers[camera[link.to]], _passages(through, link.to, leaves=False), link.to)
        low, high = link.transit.q10, link.transit.q90
        if leaving[0] > coming[0]:
            leaving, coming, low, high = coming, leaving, -high, -low
        fields = (
            leaving[0],
            leaving[1],
            coming[0],
            coming[1],
            _number(leaving[2]),
            _number(coming[2]),
            math.floor(low * FRAMES_PER_SECOND),
            math.ceil(high * FRAMES_PER_SECOND) + 1,
        )
        lines.append((fields[0], fields[2], " ".join(map(str, fields))))
    return "".join(line + "\n" for _, _, line in sorted(lines))


def camera_numbers(topology: Topology) -> dict[str, int]:
    """Integers for the cameras: the digits in their names where these differ, else their rank from
    1.
    """
    names = [camera.id for camera in topology.cameras]
    digits = [int(found[-1]) if (found := re.findall(r"[0-9]+", name)) else -1 for name in names]
    if len(set(digits)) == len(names) and -1 not in digits:
        return dict(zip(names, digits, strict=True))
    return {name: rank for rank, name in enumerate(sorted(names), 1)}


def _passages(through: list[Link], zone: str, leaves: bool) -> str:
    """The zone lists of the passages that end (or begin) at a zone; the zone alone where none is
    known.
    """
    found = [
        f"{_number(link.from_)}-{_number(link.to)}"
        for link in through
        if (link.to if leaves else link.from_) == zone and link.from_ != link.to
    ]
    return ";".join(sorted(found)) or str(_number(zone))


def _number(zone: str) -> int:
    return int(zone.rpartition("/")[2])
