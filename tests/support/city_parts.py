"""A synthetic city, and the topologies that its districts would have learned."""

from __future__ import annotations

from msgspec.structs import replace
from synthetic_topology import synthetic_topology

from camtopod.config import District, Districts, with_borders
from camtopod.records import Camera, Topology, Zone
from camtopod.topology import camera_of

CITY = replace(synthetic_topology(24), model=None, alarms=None, score=None)
OWNERS = {
    camera.id: "north" if number < 12 else "south" for number, camera in enumerate(CITY.cameras)
}
DISTRICTS = with_borders(OWNERS, [pair.cameras for pair in CITY.pairs])


def part_of(site: str, districts: Districts = DISTRICTS, shift: float = 0.002) -> Topology:
    """Return the topology of a district.

    Zones of cameras that it only hears have other numbers, and lie by ``shift`` elsewhere.
    """
    district = districts[site]
    cameras = {*district.cameras, *district.hears}

    def name(zone: str) -> str:
        camera, _, number = zone.partition("/")
        return zone if camera in district.cameras else f"{camera}/{int(number) % 4 + 11}"

    def moved(zone: Zone) -> Zone:
        if zone.camera in district.cameras:
            return zone
        return replace(zone, id=name(zone.id), x=(zone.x or 0.0) + shift)

    return replace(
        CITY,
        site=site,
        digest=f"sha256:{site}",
        cameras=[
            Camera(camera.id, [*map(name, camera.zones)], camera.clock_offset, 0.1)
            for camera in CITY.cameras
            if camera.id in cameras
        ],
        zones=[moved(zone) for zone in CITY.zones if zone.camera in cameras],
        links=[
            replace(link, from_=name(link.from_), to=name(link.to))
            for link in CITY.links
            if {camera_of(link.from_), camera_of(link.to)} <= cameras
        ],
        pairs=[pair for pair in CITY.pairs if {*pair.cameras} <= cameras],
    )


def without(district: District, camera: str) -> District:
    """Return a district that does not hear a camera."""
    return District(district.cameras, tuple(name for name in district.hears if name != camera))
