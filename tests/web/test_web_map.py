"""The map: the drawing of a topology."""

from __future__ import annotations

import math
from typing import Any

import pytest
from model_rows import with_rows
from msgspec.structs import replace
from synthetic_topology import made_link, synthetic_topology

from camtopod.export import Place, large_layout, layout, places
from camtopod.records import Lacks
from camtopod.web.map_data import MapEdge, draw, map_edges


def apart(a: Place, b: Place) -> float:
    return math.dist(a, b)


# --- what is drawn


def test_a_pair_is_an_edge_with_both_ways() -> None:
    topology = synthetic_topology(12)
    drawn = draw(topology)

    assert set(drawn.cameras) == {camera.id for camera in topology.cameras}
    assert set(drawn.edges) == {" ".join(pair.cameras) for pair in topology.pairs}
    for pair in topology.pairs:
        edge = drawn.edges[" ".join(pair.cameras)]
        assert edge.relation == pair.relation
        assert {(way.from_, way.to) for way in edge.ways} == {pair.cameras, pair.cameras[::-1]}
        assert edge.transitions == pytest.approx(sum(way.transitions for way in edge.ways))


def weak_edge(*changes: dict[str, Any]) -> MapEdge | None:
    """Return the edge of weak links, changed as given, between the first and the last camera."""
    topology = synthetic_topology(12)
    ends = topology.zones[0], topology.zones[-1]
    link = replace(made_link(ends[0].id, ends[1].id, 20.0, 12.0), q_value=0.02)
    weak = [replace(link, **changed) for changed in changes]
    return map_edges(with_rows(topology, weak=weak)).get(f"{ends[0].camera} {ends[1].camera}")


def test_evidence_that_is_nearly_enough_is_on_the_map() -> None:
    half_way = weak_edge({"transitions": 4.0, "lacks": Lacks(4.0, 300.0)})
    of_two = weak_edge({"lacks": Lacks(9.0, 900.0)}, {"lacks": Lacks(4.0, 300.0)})

    assert half_way is not None
    assert (half_way.published, half_way.relation) == (False, "unseen_path")
    assert of_two is not None
    assert "about 4 more passages" in of_two.provisional, "the nearest to being published"
    assert weak_edge({"transitions": 4.0, "lacks": Lacks(4.5, 300.0)}) is None


def test_a_map_without_links_says_what_it_waits_for() -> None:
    topology = synthetic_topology(12)
    inside = [link for link in topology.links if link.relation == "visible"]

    assert draw(topology).waiting == ""
    without = replace(topology, links=inside, pairs=[])
    assert draw(without).waiting.startswith("No two cameras are linked yet: ")


# --- where


def grid(side: int) -> dict[tuple[str, str], bool]:
    name = "{:02d}{:02d}".format
    return {
        (name(row, column), name(*other)): False
        for row in range(side)
        for column in range(side)
        for other in ((row, column + 1), (row + 1, column))
        if max(other) < side
    }


def names_of(joined: dict[tuple[str, str], bool]) -> list[str]:
    return sorted({name for pair in joined for name in pair})


def test_neighbours_are_drawn_beside_each_other_and_none_upon_another() -> None:
    joined = grid(6)
    at = places(names_of(joined), joined, {})
    assert all(0.6 < apart(at[a], at[b]) < 1.6 for a, b in joined)
    assert min(apart(at[a], at[b]) for a in at for b in at if a < b) > 0.5


def test_a_small_change_moves_little() -> None:
    joined = grid(6)
    before = places(names_of(joined), joined, {})
    more = {**joined, ("0505", "new"): False}
    after = places(names_of(more), more, before)
    shift = [apart(after[name], before[name]) for name in before]

    assert max(shift) < 0.5, "those that were there stay about where they were"
    assert apart(after["new"], after["0505"]) < 1.6


def test_a_first_link_moves_no_camera_without_one() -> None:
    before = places("abcdef", {}, {})
    after = places("abcdefg", {("a", "b"): True}, before)
    assert all(after[name] == pytest.approx(before[name]) for name in "cdef")
    assert min(apart(after[a], after[b]) for a in after for b in after if a < b) > 0.49


def test_a_large_site_is_placed_by_few_of_its_distances_and_about_as_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    joined = grid(14)
    monkeypatch.setattr(layout, "DENSE_MAX", 100)
    monkeypatch.setattr(large_layout, "PIVOTS_MAX", 20)  # of 196 cameras
    at = places(names_of(joined), joined, {})

    assert all(0.6 < apart(at[a], at[b]) < 1.6 for a, b in joined)
    assert min(apart(at[a], at[b]) for a in at for b in at if a < b) > 0.5
    corners = apart(at["0000"], at["1313"]), apart(at["0013"], at["1300"])
    assert min(corners) > 14, "it is unfolded"

    more = {**joined, ("1313", "new"): False}
    after = places(names_of(more), more, at)
    assert max(apart(after[name], at[name]) for name in at) < 0.6
    assert apart(after["new"], after["1313"]) < 1.6


def test_cameras_with_the_same_neighbours_lie_apart_on_a_large_site(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(layout, "DENSE_MAX", 3)
    star = {("middle", name): False for name in ("a", "b", "c", "d", "e")}
    at = places(names_of(star), star, {})

    assert min(apart(at[a], at[b]) for a in at for b in at if a < b) > 0.5
