"""Cutting a city into districts."""

from __future__ import annotations

import random
from collections import Counter
from itertools import pairwise

import networkx as nx
import pytest

from camtopod.city.partition import partition


def grid(side: int) -> dict[tuple[str, str], float]:
    """Return the passages of a square city, whose streets are used differently."""
    chance = random.Random(side)
    graph = nx.grid_2d_graph(side, side)
    return {
        (f"{a[0]:02}-{a[1]:02}", f"{b[0]:02}-{b[1]:02}"): chance.uniform(20, 200)
        for a, b in graph.edges
    }


@pytest.mark.parametrize("cameras_max", [10, 30, 50])
def test_districts_are_connected_and_none_is_too_large(cameras_max: int) -> None:
    passages = grid(15)
    graph = nx.Graph(list(passages))

    owners = partition(sorted(graph), passages, cameras_max)

    sizes = Counter(owners.values())
    assert owners.keys() == set(graph)
    assert max(sizes.values()) <= cameras_max
    assert len(sizes) <= 1.5 * 225 / cameras_max
    for district in sizes:
        assert nx.is_connected(graph.subgraph(c for c in owners if owners[c] == district))


def test_it_cuts_where_few_objects_pass() -> None:
    """Four quarters of a town, which bridges join."""
    quarters = ["north", "east", "south", "west"]
    passages = {
        (f"{quarter}{a}", f"{quarter}{b}"): 100.0
        for quarter in quarters
        for a, b in nx.grid_2d_graph(3, 4).edges
    }
    passages |= {(f"{a}(0, 0)", f"{b}(2, 3)"): 3.0 for a, b in pairwise(quarters)}
    cameras = sorted({camera for pair in passages for camera in pair})

    owners = partition(cameras, passages, 15)

    assert [a for a in passages if owners[a[0]] != owners[a[1]]] == [
        pair for pair, number in passages.items() if number == 3.0
    ]


def test_the_same_city_is_cut_in_the_same_way() -> None:
    passages = grid(10)
    cameras = sorted({camera for pair in passages for camera in pair})

    assert partition(cameras, passages, 20) == partition(cameras, passages, 20)
    assert partition(cameras, passages, 20)[cameras[0]] == "d1"


def test_places_that_nothing_connects_are_put_together() -> None:
    cameras = [f"c{number}" for number in range(30)]

    sizes = Counter(partition(cameras, {("c1", "c2"): 5.0}, 12).values())

    assert max(sizes.values()) <= 12
    assert len(sizes) <= 4


def test_one_district_holds_a_small_city() -> None:
    assert partition(["a", "b"], {("a", "b"): 1.0}, 10) == {"a": "d1", "b": "d1"}
