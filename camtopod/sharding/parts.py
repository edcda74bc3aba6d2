"""Parts: the share of one district in the topology of the site.

A district fits more cameras than its own. `part_of` takes from its topology what belongs to its own
cameras: the cameras with their zones, the links that end there, and the predictions of objects that
appear there. `merge` puts the parts of all districts together.
"""

from __future__ import annotations

from collections.abc import Set

from msgspec import Struct
from msgspec.structs import replace

from camtopod.records import Alarm, Model, Onward, Topology
from camtopod.sharding.assignment import Assignment
from camtopod.topology import round_significant, with_digest


class Part(Struct, frozen=True):
    """The part that a district publishes with each version.

    district: number of the district.
    topology: the district's own cameras, their zones and the links that end there; and the zones of
        other cameras where these links begin, under the ids that this district gave them
        (`match_zones` finds the ids of their owners). In the model, next appearances are listed if
        they are at own cameras; all others are included in ``leave``.
    rates: events per second of each own camera in the window.
    """

    district: int
    topology: Topology
    rates: dict[str, float]


def part_of(topology: Topology, district: int, rates: dict[str, float], events: int) -> Part:
    """Return the part of a district, taken from the topology that it has learned.

    district: number of the district.
    rates: events per second of each own camera; defines which cameras are own.
    events: number of events of own cameras so far.
    """
    zones = {zone.id for zone in topology.zones if zone.camera in rates}
    links = [link for link in topology.links if link.to in zones]
    weak = [link for link in topology.weak_links or [] if link.to in zones]
    model = None if topology.model is None else _own_model(topology.model, zones, rates.keys())

    # Zones of other cameras where links, next appearances or entry kernels begin.
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
    """Return True if all cameras of a part are assigned to its district."""
    districts = range(dealing.sharding.districts)
    return part.district in districts and all(
        dealing.district(camera) == part.district for camera in part.rates
    )


def _own_model(model: Model, zones: Set[str], cameras: Set[str]) -> Model:
    """Return the part of a model that concerns a district's own cameras.

    zones, cameras: ids of the own zones, and names of the own cameras.
    """
    onward = [_own_outcomes(row, zones) for row in model.onward or []]
    onward = [row for row in onward if row.next_ or row.zone in zones]
    zones_told = {row.zone for row in onward}
    contexts = [
        replace(row, to={zone: number for zone, number in row.to.items() if zone in zones})
        for row in model.contexts or []
        if row.zone in zones_told
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
    """Return the next appearances from one zone at own zones only.

    zones: ids of the own zones. Objects that appear next elsewhere count as leaving the site, as
        other districts predict these.
    """
    elsewhere = sum(outcome.share for outcome in row.next_ if outcome.to not in zones)
    if not elsewhere:
        return row
    return Onward(
        row.zone,
        round_significant(min(row.leave + elsewhere, 1.0)),
        [outcome for outcome in row.next_ if outcome.to in zones],
    )


def _is_of(alarm: Alarm, cameras: Set[str]) -> bool:
    """Return True if an alarm's subject (camera, zone, or link to a zone) is of the ``cameras``."""
    return alarm.subject.split("->")[-1].split("/")[0] in cameras
