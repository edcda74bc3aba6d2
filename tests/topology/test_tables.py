"""A topology as tables: links, next cameras, histograms."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from synthetic_topology import synthetic_topology

from camtopod.records import Histogram
from camtopod.topology import LagBins

TOPOLOGY = synthetic_topology(7)


def test_a_matrix_has_the_next_cameras_and_what_no_link_tells() -> None:
    cameras, probability, unlinked = TOPOLOGY.matrix()
    exits = {zone.id: zone.exits for zone in TOPOLOGY.zones}
    camera = {zone.id: zone.camera for zone in TOPOLOGY.zones}

    assert cameras == [camera.id for camera in TOPOLOGY.cameras]
    for a, row, remainder in zip(cameras, probability, unlinked, strict=True):
        assert sum(row) + remainder == pytest.approx(1.0) or (sum(row) > 1.0 and remainder == 0.0)
        total = sum(number for zone, number in exits.items() if camera[zone] == a)
        for b, share in zip(cameras, row, strict=True):
            expected = sum(
                link.probability * exits[link.from_] / total
                for link in TOPOLOGY.links
                if (camera[link.from_], camera[link.to]) == (a, b) and link.relation != "visible"
            )
            assert share == pytest.approx(min(expected, 1.0))


def test_links_are_found_by_cameras_and_by_zones() -> None:
    for row, link in zip(TOPOLOGY.links_table(), TOPOLOGY.links, strict=True):
        assert (row["from"], row["to"], row["q50"]) == (link.from_, link.to, link.transit.q50)
        assert TOPOLOGY.link(link.from_, link.to).relation == link.relation
        busiest = TOPOLOGY.link(row["from_camera"], row["to_camera"])
        assert busiest.transitions >= link.transitions
    with pytest.raises(KeyError, match="no link from nowhere to"):
        TOPOLOGY.link("nowhere", TOPOLOGY.zones[0].id)


def test_a_histogram_has_the_edges_of_its_lag_bins() -> None:
    bins = LagBins(-20.0, 120.0)
    mass = [4.0] * bins.size
    histogram = Histogram(bins.first, mass, unit=0.5, delay=30.0)

    edges, masses = replace(TOPOLOGY.links[0], histogram=histogram).times()

    assert edges == pytest.approx((bins.edges + 30.0).tolist())
    assert masses == [2.0] * bins.size
    assert replace(TOPOLOGY.links[0], histogram=None).times() == ([0.0], [])
