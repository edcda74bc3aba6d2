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

from camtopod.records import Topology

FRAMES_PER_SECOND = 10.0
"""Frame rate of the challenge's videos."""


def to_aicity(topology: Topology) -> str:
    """Return the links between cameras as transition lines; the time window is q10 to q90."""
    numbers = camera_numbers(topology)
    camera = {zone.id: zone.camera for zone in topology.zones}
    beginning, ending = _passages(topology)
    lines = []
    for link in topology.links:
        if link.relation == "visible" or camera[link.from_] == camera[link.to]:
            continue

        # Both sides: number of the camera, zones of the passages, zone. The lower number is first.
        sides = [
            (numbers[camera[link.from_]], _zone_lists(link.from_, ending), _number(link.from_)),
            (numbers[camera[link.to]], _zone_lists(link.to, beginning), _number(link.to)),
        ]
        times = [link.transit.q10, link.transit.q90]
        if sides[0][0] > sides[1][0]:
            sides.reverse()
            times = [-link.transit.q90, -link.transit.q10]

        # The line, and the numbers by which lines are sorted.
        (a, passages_a, zone_a), (b, passages_b, zone_b) = sides
        first = math.floor(times[0] * FRAMES_PER_SECOND)
        last = math.ceil(times[1] * FRAMES_PER_SECOND) + 1
        fields = (a, passages_a, b, passages_b, zone_a, zone_b, first, last)
        lines.append((a, b, " ".join(map(str, fields))))
    return "".join(line + "\n" for _, _, line in sorted(lines))


def camera_numbers(topology: Topology) -> dict[str, int]:
    """Return an integer for each camera: the last number in its name, if all differ, else its rank.

    Ranks count from 1 in the order of names.
    """
    names = [camera.id for camera in topology.cameras]
    digits = [re.findall(r"[0-9]+", name)[-1:] for name in names]
    numbers = {name: int(group[0]) for name, group in zip(names, digits, strict=True) if group}
    if len(set(numbers.values())) == len(names):
        return numbers
    return {name: rank for rank, name in enumerate(sorted(names), 1)}


def _passages(topology: Topology) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Return the zone lists of all passages, by the zone where they begin, and where they end."""
    beginning: dict[str, list[str]] = {}
    ending: dict[str, list[str]] = {}
    for link in topology.links:
        if link.relation == "visible" and link.from_ != link.to:
            zones = f"{_number(link.from_)}-{_number(link.to)}"
            beginning.setdefault(link.from_, []).append(zones)
            ending.setdefault(link.to, []).append(zones)
    return beginning, ending


def _zone_lists(zone: str, passages: dict[str, list[str]]) -> str:
    """Return the zone lists of the passages of a zone; if there are none, the zone alone."""
    return ";".join(sorted(passages.get(zone, [str(_number(zone))])))


def _number(zone: str) -> int:
    """Return the number of a zone within its camera."""
    return int(zone.rpartition("/")[2])
