"""One map of many districts."""

from __future__ import annotations

from city_parts import CITY, DISTRICTS, OWNERS, part_of
from msgspec.structs import replace

from camtopod.city.joined_map import joined_map
from camtopod.records import Link, Model, Topology
from camtopod.topology import camera_of, weak_columns, weak_links

PARTS = [part_of("north"), part_of("south")]


def test_the_districts_of_a_map_join_to_the_map() -> None:
    city, zones_unmatched, links_left_out = joined_map(PARTS, OWNERS)

    assert (zones_unmatched, links_left_out) == (0, 0)
    for field in ("cameras", "zones", "links", "pairs"):
        assert getattr(city, field) == getattr(CITY, field)
    assert any(OWNERS[camera_of(x.from_)] != OWNERS[camera_of(x.to)] for x in city.links)


def test_a_copy_at_no_place_of_the_owner_is_left_out_and_counted() -> None:
    south = part_of("south", shift=0.4)
    heard = DISTRICTS["south"].hears

    city, zones_unmatched, links_left_out = joined_map([PARTS[0], south], OWNERS)

    assert zones_unmatched == sum(zone.camera in heard for zone in south.zones)
    assert links_left_out == len(CITY.links) - len(city.links)
    assert (
        0
        < links_left_out
        == sum(
            OWNERS[camera_of(link.from_)] == "south" and camera_of(link.to) in heard
            for link in CITY.links
        )
    )


def test_cameras_without_positions_are_one_zone_each() -> None:
    def plain(part: Topology) -> Topology:
        zones = [replace(zone, x=None, y=None, cov=None) for zone in part.zones]
        first = {zone.camera: zone.id for zone in reversed(zones)}
        links = [link for link in part.links if {link.from_, link.to} <= {*first.values()}]
        return replace(part, zones=[z for z in zones if first[z.camera] == z.id], links=links)

    city, zones_unmatched, _ = joined_map([plain(part) for part in PARTS], OWNERS)

    assert zones_unmatched == 0
    assert {zone.id for zone in city.zones} == {zone.id for zone in plain(CITY).zones}


def test_weak_links_are_those_of_the_owner_on_the_bins_of_all() -> None:
    def with_model(part: Topology, longest: float, weak: list[Link]) -> Topology:
        columns = weak_columns(weak, part.zones)
        return replace(part, model=Model(1.0, 0.1, -longest, longest, b"", weak_links=columns))

    across = [
        replace(link, histogram=None)
        for link in PARTS[0].links
        if OWNERS[camera_of(link.from_)] != OWNERS[camera_of(link.to)]
    ]
    outgoing = [link for link in across if OWNERS[camera_of(link.from_)] == "north"]

    city, *_ = joined_map(
        [with_model(PARTS[0], 60.0, across), with_model(PARTS[1], 90.0, [])], OWNERS
    )

    assert city.model is not None
    assert (city.model.lag_min, city.model.lag_max) == (-90.0, 90.0)
    weak = weak_links(city)
    assert [link.from_ for link in weak] == sorted(link.from_ for link in outgoing) != []
    assert {link.to for link in weak} <= {zone.id for zone in CITY.zones}
