"""The map: the drawing of a topology, and its changes from version to version."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from msgspec.structs import replace
from synthetic_topology import made_link, synthetic_topology

from camtopod.export import Place, places
from camtopod.records import Lacks, Link, Pair, Topology
from camtopod.web.map_data import (
    Map,
    MapCamera,
    MapChange,
    change,
    draw,
    map_edges,
    why_provisional,
)

SETTLED = Pair(("a", "b"), "overlapped", "overlapped", "overlapped")


def applied(old: Map, delta: MapChange) -> tuple[dict[str, object], dict[str, object]]:
    """Return the page's cameras and edges after a change."""
    cameras = {
        name: one for name, one in old.cameras.items() if name not in delta.gone_cameras
    } | delta.cameras
    edges = {
        key: one for key, one in old.edges.items() if key not in delta.gone_edges
    } | delta.edges
    return dict(cameras), dict(edges)


def apart(a: Place, b: Place) -> float:
    return math.dist(a, b)


# --- what is drawn
# ----------------------------------------------------------------------------------


def test_a_pair_is_an_edge_with_both_ways() -> None:
    topology = synthetic_topology(12)
    drawn = draw(topology)
    assert set(drawn.cameras) == {camera.id for camera in topology.cameras}
    assert set(drawn.edges) == {" ".join(pair.cameras) for pair in topology.pairs}
    for pair in topology.pairs:
        edge = drawn.edges[" ".join(pair.cameras)]
        assert edge.relation == pair.relation
        assert {(way.from_, way.to) for way in edge.ways} == {pair.cameras, pair.cameras[::-1]}
        assert edge.transitions == pytest.approx(sum(way.transitions for way in edge.ways), rel=0.1)


@pytest.mark.parametrize(
    ("pair", "transitions", "word"),
    [
        (SETTLED, 30.0, ""),
        (SETTLED, 29.0, "new"),
        (None, 500.0, "not published"),
        (replace(SETTLED, by_sum_rule="unseen_path", reason="few"), 500.0, "disagree (few)"),
        (replace(SETTLED, by_sum_rule=None), 500.0, ""),
    ],
)
def test_provisional_says_why(pair: Pair | None, transitions: float, word: str) -> None:
    said = why_provisional(pair, transitions, made_link("a/1", "b/1", 10.0, transitions))
    assert word in said
    assert bool(said) is bool(word)


def test_weak_evidence_is_told_by_its_own_figure() -> None:
    link = made_link("a/1", "b/1", 10.0, 50.0)
    assert (
        why_provisional(None, 50.0, replace(link, q_value=0.03))
        == "not published: it may be spurious (q = 0.03)"
    )
    assert "not all rules for publishing" in why_provisional(
        None, 50.0, replace(link, q_value=1e-6)
    )


@pytest.mark.parametrize(
    ("passages", "seconds", "said"),
    [
        (1.2, 30.0, "one more passage, 1 minute at this traffic"),
        (6.6, 457.0, "about 7 more passages, 8 minutes at this traffic"),
        (30.0, 4 * 3600.0, "about 30 more passages, 4 hours at this traffic"),
        (30.0, 5 * 86400.0, "about 30 more passages, 5 days at this traffic"),
    ],
)
def test_what_a_link_lacks_is_said(passages: float, seconds: float, said: str) -> None:
    link = replace(
        made_link("a/1", "b/1", 10.0, 50.0), q_value=0.03, lacks=Lacks(passages, seconds)
    )
    assert why_provisional(None, 50.0, link) == f"not published yet: it lacks {said}"


def test_of_several_links_the_nearest_to_being_published_speaks_for_the_pair() -> None:
    topology = synthetic_topology(12)
    key = f"{topology.cameras[0].id} {topology.cameras[-1].id}"
    there = made_link(topology.zones[0].id, topology.zones[-1].id, 20.0, 12.0)
    back = made_link(topology.zones[-1].id, topology.zones[0].id, 20.0, 12.0)
    weak = [
        replace(there, q_value=0.02, lacks=Lacks(9.0, 900.0)),
        replace(back, q_value=0.03, lacks=Lacks(4.0, 300.0)),
    ]
    assert (
        "about 4 more passages" in draw(replace(topology, weak_links=weak)).edges[key].provisional
    )


def with_weak(topology: Topology, **changed: float) -> Topology:
    """Add weak evidence between the first and the last camera."""
    link = made_link(topology.zones[0].id, topology.zones[-1].id, 20.0, 12.0)
    weak: list[Link] = [replace(link, **{"q_value": 0.02, **changed})]
    return replace(topology, weak_links=weak)


def test_evidence_that_is_nearly_enough_is_on_the_map_and_moves_nobody() -> None:
    topology = synthetic_topology(12)
    key = f"{topology.cameras[0].id} {topology.cameras[-1].id}"
    drawn = draw(with_weak(topology))
    assert drawn.edges[key].provisional.startswith("not published")
    assert drawn.edges[key].relation == "unseen_path"
    assert drawn.cameras == draw(topology).cameras
    assert key not in map_edges(with_weak(topology, q_value=0.06))
    assert key not in map_edges(with_weak(topology, transitions=4.0))


def test_a_weak_link_that_is_half_way_is_on_the_map_whatever_its_figure() -> None:
    topology = synthetic_topology(12)
    key = f"{topology.cameras[0].id} {topology.cameras[-1].id}"
    link = made_link(topology.zones[0].id, topology.zones[-1].id, 20.0, 4.0)
    near, far = (replace(link, q_value=1.0, lacks=Lacks(n, 300.0)) for n in (4.0, 4.5))
    assert not map_edges(replace(topology, weak_links=[near]))[key].published
    assert key not in map_edges(replace(topology, weak_links=[far]))


def test_a_map_without_links_says_what_it_waits_for() -> None:
    topology = synthetic_topology(12)
    inside = [link for link in topology.links if link.relation == "visible"]
    assert draw(topology).waiting == ""
    without = replace(topology, links=inside, pairs=[])
    assert draw(without).waiting.startswith("No two cameras are linked yet: ")
    assert change(draw(without), draw(topology)).waiting == ""


@pytest.mark.parametrize("number", [1, 4, 5, 7, 11, 23])
def test_cameras_without_links_stand_in_even_rows(number: int) -> None:
    at = places([f"c{k:02d}" for k in range(number)], {}, {})
    rows = Counter(y for _, y in at.values())
    assert max(rows.values()) - min(rows.values()) <= 1
    assert max(rows.values()) >= len(rows), "wider than high"
    for y in rows:
        xs = sorted(x for x, other in at.values() if other == y)
        assert (xs[0] + xs[-1]) / 2 == pytest.approx(np.mean([x for x, _ in at.values()]), abs=0.2)


# --- what changes
# -----------------------------------------------------------------------------------


def test_a_change_makes_the_new_map_of_the_old() -> None:
    topology = synthetic_topology(12)
    links = [
        replace(link, probability=0.2) if link.from_.startswith("cam0003/") else link
        for link in topology.links
        if "cam0005/" not in link.from_ + link.to
    ]
    gone = [pair for pair in topology.pairs if "cam0005" not in pair.cameras]
    newer = replace(
        topology,
        version=2,
        links=links,
        pairs=gone,
        cameras=[c for c in topology.cameras if c.id != "cam0005"],
        zones=[zone for zone in topology.zones if zone.camera != "cam0005"],
    )
    old = draw(topology)
    new = draw(newer, old)
    delta = change(old, new)
    assert applied(old, delta) == (new.cameras, new.edges)
    assert delta.gone_cameras == ["cam0005"]
    assert (delta.since, delta.version) == (1, 2)


def test_what_nobody_could_see_is_no_change() -> None:
    topology = synthetic_topology(12)
    links = [replace(link, transitions=link.transitions * 1.001) for link in topology.links]
    old = draw(topology)
    delta = change(old, draw(replace(topology, version=2, links=links), old))
    assert len(delta.edges) <= 2  # some cross a border of rounding
    assert delta.cameras == {}


# --- where
# ------------------------------------------------------------------------------------------


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


def test_the_same_network_has_the_same_places_in_any_order() -> None:
    joined = grid(5)
    names = names_of(joined)
    assert places(names, joined, {}) == places(names[::-1], dict(reversed(joined.items())), {})


def test_overlapping_views_lie_nearer() -> None:
    at = places("abc", {("a", "b"): True, ("b", "c"): False}, {})
    assert apart(at["a"], at["b"]) < 0.8 * apart(at["b"], at["c"])


def test_a_small_change_moves_little() -> None:
    joined = grid(6)
    before = places(names_of(joined), joined, {})
    more = {**joined, ("0505", "new"): False}
    after = places(names_of(more), more, before)
    shift = [apart(after[name], before[name]) for name in before]
    assert max(shift) < 0.5, "those that were there stay about where they were"
    assert apart(after["new"], after["0505"]) < 1.6


def test_parts_lie_apart_and_a_lone_camera_has_a_place() -> None:
    joined = {("a", "b"): False, ("b", "c"): False, ("x", "y"): False}
    at = places(["a", "b", "c", "x", "y", "alone"], joined, {})
    assert min(apart(at[one], at[other]) for one in "abc" for other in ("x", "y", "alone")) > 0.6
    assert places([], {}, {}) == {}


def test_a_map_without_a_change_of_the_network_stays_as_it_is() -> None:
    topology = synthetic_topology(30)
    old = draw(topology)
    moved = {
        name: MapCamera(one.x + 1, one.y, one.zones, one.entries, one.exits)
        for name, one in old.cameras.items()
    }
    kept = draw(replace(topology, version=2), replace(old, cameras=moved))
    assert kept.cameras == moved


def test_a_pair_whose_links_are_not_listed_is_drawn() -> None:
    topology = synthetic_topology(12)
    pair = topology.pairs[0]
    inside = [link for link in topology.links if link.relation == "visible"]
    edge = draw(replace(topology, links=inside)).edges[" ".join(pair.cameras)]
    assert (edge.relation, edge.ways) == (pair.relation, [])
    assert edge.provisional.startswith("new")
