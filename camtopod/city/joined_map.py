"""One map of many districts: of each part of a city, what belongs to the cameras that it owns.

A link belongs to the part that owns its camera of departure. Where it leads across the border, it
ends in a copy: a zone as this part has learned it. The zone that the camera's owner has learned at
the same place takes its place.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from camtopod.learn.zones import ZoneShape, same_places
from camtopod.records import TOPOLOGY_SCHEMA, Link, Model, Pair, Topology, Zone
from camtopod.topology import camera_of, link_key, weak_columns, weak_links


class JoinedMap(NamedTuple):
    """The map of a city, and how much of its parts is not in it.

    topology: without site, epoch, version and digest.
    zones_unmatched: copies of zones at whose place the camera's owner has none.
    links_left_out: links that lead there.
    """

    topology: Topology
    zones_unmatched: int
    links_left_out: int


def joined_map(parts: Sequence[Topology], owners: Mapping[str, str]) -> JoinedMap:
    """Return one map of the parts of a city; ids stay as they are.

    parts: topologies of different sites, whose models have lag bins of one scale.
    owners: by camera, the site of the part that owns it; for each camera of the parts.

    The map is as of the newest part. An event of a camera that several parts hear counts for each.
    """
    zones = [zone for part in parts for zone in part.zones if owners[zone.camera] == part.site]
    zones.sort(key=lambda zone: zone.id)
    zones_of: dict[str, list[Zone]] = defaultdict(list)
    for zone in zones:
        zones_of[zone.camera].append(zone)

    # Links with the owners' zones, by part.
    links: list[Link] = []
    weak: list[Link] = []
    zones_unmatched = links_left_out = 0
    for part in parts:
        name_of = zone_names(part, owners, zones_of)
        zones_unmatched += len(part.zones) - len(name_of)
        for result, part_links in ((links, part.links), (weak, weak_links(part))):
            own_links = [link for link in part_links if owners[camera_of(link.from_)] == part.site]
            inner_links = [link for link in own_links if link.to in name_of]
            result += [replace(link, to=name_of[link.to]) for link in inner_links]
            links_left_out += len(own_links) - len(inner_links)

    # Related cameras: across a border as the owner of the first of the two says, else the other.
    cameras = [
        camera for part in parts for camera in part.cameras if owners[camera.id] == part.site
    ]
    related_cameras = {frozenset((camera_of(link.from_), camera_of(link.to))) for link in links}
    pairs: dict[tuple[str, str], Pair] = {}
    for end in (1, 0):
        pairs |= {
            pair.cameras: pair
            for part in parts
            for pair in part.pairs
            if owners[pair.cameras[end]] == part.site and frozenset(pair.cameras) in related_cameras
        }
    topology = Topology(
        schema=TOPOLOGY_SCHEMA,
        site="",
        epoch="",
        version=0,
        as_of=max(part.as_of for part in parts),
        events=sum(part.events for part in parts),
        digest="",
        cameras=sorted(cameras, key=lambda camera: camera.id),
        zones=zones,
        links=sorted(links, key=link_key),
        pairs=[pairs[key] for key in sorted(pairs)],
    )
    models = [part.model for part in parts if part.model is not None]
    if models:  # the lag bins of all histograms, and the weak links
        model = Model(
            models[0].lag_scale,
            models[0].lag_step,
            min(model.lag_min for model in models),
            max(model.lag_max for model in models),
            b"",
            weak_links=weak_columns(sorted(weak, key=link_key), zones),
        )
        topology = replace(topology, model=model)
    return JoinedMap(topology, zones_unmatched, links_left_out)


def zone_names(
    part: Topology, owners: Mapping[str, str], zones_of: Mapping[str, Sequence[Zone]]
) -> dict[str, str]:
    """Return, by zone of a part, the zone of the camera's owner at the same place.

    zones_of: the owners' zones, by camera. A zone at whose place the owner has none is left out.
    """
    names = {zone.id: zone.id for zone in part.zones if owners[zone.camera] == part.site}
    copies: dict[str, list[Zone]] = defaultdict(list)
    for zone in part.zones:
        if zone.id not in names:
            copies[zone.camera].append(zone)
    for camera, zones in copies.items():
        owned_zones = zones_of.get(camera, ())
        matches = same_places([_shape(zone) for zone in owned_zones], [_shape(z) for z in zones])
        names |= {zones[k].id: owned_zones[at].id for k, at in matches.items()}
    return names


def _shape(zone: Zone) -> ZoneShape:
    """Return a zone's place; the one zone of a camera without positions is in a corner."""
    (xx, xy), (yx, yy) = zone.cov or ((0.0, 0.0), (0.0, 0.0))
    return ZoneShape(0, zone.x or 0.0, zone.y or 0.0, ((xx, xy), (yx, yy)), 0.0)
