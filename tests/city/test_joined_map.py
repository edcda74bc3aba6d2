"""One map of many districts."""

from __future__ import annotations

import numpy as np
import pytest
from city_parts import CITY, DISTRICTS, OWNERS, part_of
from msgspec.structs import replace

from camtopod.city.joined_map import joined_map
from camtopod.columns import packed
from camtopod.records import Link, Model, Topology
from camtopod.topology import by_name, camera_of, weak_columns, weak_links

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


@pytest.mark.parametrize("field", ["departures", "arrival_rate"])
def test_figures_of_models_are_those_of_the_owner(field: str) -> None:
    kind = np.int32 if field == "departures" else np.float32

    def with_model(part: Topology, figure: int, weak: list[Link]) -> Topology:
        column = packed([figure] * len(part.zones), kind)
        model = Model(
            1.0, 0.1, -60.0, 60.0 * figure, b"", weak_links=weak_columns(weak, part.zones)
        )
        return replace(part, model=replace(model, **{field: column}))

    weak = [
        replace(link, histogram=None)
        for link in PARTS[0].links
        if OWNERS[camera_of(link.from_)] == "north" and OWNERS[camera_of(link.to)] == "south"
    ]
    city, *_ = joined_map([with_model(PARTS[0], 1, weak), with_model(PARTS[1], 2, [])], OWNERS)

    assert city.model is not None
    figures = by_name((zone.id for zone in city.zones), getattr(city.model, field), kind)
    assert {camera_of(z): f for z, f in figures.items()} == {
        camera: 1 if owner == "north" else 2 for camera, owner in OWNERS.items()
    }
    assert (city.model.lag_min, city.model.lag_max) == (-60.0, 120.0)
    assert {link.to for link in weak_links(city)} <= {zone.id for zone in CITY.zones}
    assert len(weak_links(city)) == len(weak) > 0
