"""Parts: what one district knows of its own cameras and of the links into them."""

from __future__ import annotations

from collections.abc import Set

from msgspec import Struct
from msgspec.structs import replace

from camtopod.records import Alarm, Model, Onward, Topology
from camtopod.sharding.assignment import Assignment
from camtopod.topology import round_significant, with_digest


class Part(Struct, frozen=True):
    """What a district publishes with each version.

    ``topology`` holds the district's own cameras, their zones and the links that end there, and the
    zones of other cameras where these links begin, under the numbers that this district gave them
    (`match_zones` finds the owner's). Next appearances are listed as far as they are at own
    cameras; ``leave`` covers all others.
    """

    district: int
    topology: Topology
    rates: dict[str, float]
    """Events per second of each own camera in the window."""


def part_of(topology: Topology, district: int, rates: dict[str, float], events: int) -> Part:
    """Return the part of a district's topology that is its own.

    rates (by own camera, 1/s): events per second.
    events: number of events of own cameras so far.
    """
    zones = {zone.id for zone in topology.zones if zone.camera in rates}
    links = [link for link in topology.links if link.to in zones]
    weak = [link for link in topology.weak_links or [] if link.to in zones]
    model = None if topology.model is None else _own_model(topology.model, zones, rates.keys())

    # Zones of other cameras that links, next appearances or entry kernels begin at.
    named = {link.from_ for link in (*links, *weak)} | {
        row.zone for row in (model and model.onward) or []
    }
    named |= {kernel.zone for kernel in (model and model.entered) or []}
    senders = {zone.camera for zone in topology.zones if zone.id in named}

    own = replace(
        topology,
        cameras=[camera for camera in topology.cameras if camera.id in rates],
        zones=[zone for zone in topology.zones if zone.camera in rates or zone.camera in senders],
        links=links,
        weak_links=weak,
        pairs=[],
        chain=None,
        model=model,
        alarms=[alarm for alarm in topology.alarms or [] if _is_of(alarm, rates.keys())] or None,
        events=events,
    )
    return Part(district, with_digest(own), rates)


def is_assigned(part: Part, dealing: Assignment) -> bool:
    """Return True if all cameras of the part are assigned to its district."""
    here = range(dealing.sharding.districts)
    return part.district in here and all(
        dealing.district(camera) == part.district for camera in part.rates
    )


def _own_model(model: Model, zones: Set[str], cameras: Set[str]) -> Model:
    """Return the model with next appearances at the own ``zones`` of the own ``cameras`` only."""
    onward = [_own_outcomes(row, zones) for row in model.onward or []]
    onward = [row for row in onward if row.next_ or row.zone in zones]
    told = {row.zone for row in onward}
    contexts = [
        replace(row, to={zone: number for zone, number in row.to.items() if zone in zones})
        for row in model.contexts or []
        if row.zone in told
    ]
    ways = [way for way in model.pace.ways if way.exit in zones] if model.pace else []

    return replace(
        model,
        zones=[zone for zone in model.zones if zone.zone in zones],
        cameras=[camera for camera in model.cameras if camera.camera in cameras],
        onward=None if model.onward is None else onward,
        entered=None
        if model.entered is None
        else [kernel for kernel in model.entered if kernel.to in zones],
        contexts=None if model.contexts is None else contexts,
        overlaps=None
        if model.overlaps is None
        else [row for row in model.overlaps if row.to in cameras],
        pace=None if model.pace is None else replace(model.pace, ways=ways),
    )


def _own_outcomes(row: Onward, zones: Set[str]) -> Onward:
    """Count objects that appear next elsewhere as leaving, as other districts predict those."""
    elsewhere = sum(outcome.share for outcome in row.next_ if outcome.to not in zones)
    if not elsewhere:
        return row
    return Onward(
        row.zone,
        round_significant(min(row.leave + elsewhere, 1.0)),
        [outcome for outcome in row.next_ if outcome.to in zones],
    )


def _is_of(alarm: Alarm, cameras: Set[str]) -> bool:
    """Return True if the alarm's subject (camera, zone, or link into one) is of the ``cameras``."""
    return alarm.subject.split("->")[-1].split("/")[0] in cameras
