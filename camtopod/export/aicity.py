"""Camera link model of the AI City challenge: ``camera_transitions.txt`` of UWIPL's code (2019).

A line per transition has eight fields, separated by spaces: camera and zone lists of one side,
camera and zone lists of the other, the two zones between which the time counts, and the smallest
and largest time in frames. Cameras and zones are integers. The lower camera number comes first and
times run from there, so objects that go the other way have negative times. A zone list is the zones
of one passage, ``3-1``; semicolons separate alternatives.
"""

from __future__ import annotations

import math
import re

from camtopod.records import Link, Topology

FRAMES_PER_SECOND = 10.0
"""Frame rate of the challenge's videos."""


def to_aicity(topology: Topology) -> str:
    """Return the links between cameras as transition lines; the time window is q10 to q90."""
    numbers = camera_numbers(topology)
    camera = {zone.id: zone.camera for zone in topology.zones}
    through = [link for link in topology.links if link.relation == "visible"]
    lines = []
    for link in topology.links:
        if link.relation == "visible" or camera[link.from_] == camera[link.to]:
            continue

        # Both sides, with the zones of their passages.
        leaving = (
            numbers[camera[link.from_]],
            _passages(through, link.from_, leaves=True),
            link.from_,
        )
        coming = (numbers[camera[link.to]], _passages(through, link.to, leaves=False), link.to)

        # The lower camera number comes first.
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
    """Return an integer for each camera: the last number in its name, if all differ, else its rank.

    Ranks count from 1 in the order of names.
    """
    names = [camera.id for camera in topology.cameras]
    digits = [int(found[-1]) if (found := re.findall(r"[0-9]+", name)) else -1 for name in names]
    if len(set(digits)) == len(names) and -1 not in digits:
        return dict(zip(names, digits, strict=True))
    return {name: rank for rank, name in enumerate(sorted(names), 1)}


def _passages(through: list[Link], zone: str, leaves: bool) -> str:
    """Return the zone lists of the passages that end (or begin) at a zone.

    If there are none, the zone alone.
    """
    found = [
        f"{_number(link.from_)}-{_number(link.to)}"
        for link in through
        if (link.to if leaves else link.from_) == zone and link.from_ != link.to
    ]
    return ";".join(sorted(found)) or str(_number(zone))


def _number(zone: str) -> int:
    """Return the number of a zone within its camera."""
    return int(zone.rpartition("/")[2])
