"""Merging the topologies of districts."""

from __future__ import annotations

import pytest
from city_parts import CITY, DISTRICTS, OWNERS, part_of, without
from msgspec.structs import replace

from camtopod.city.merge import digest_of, merge
from camtopod.codec import Rejected, decode_topology, to_json
from camtopod.config import District
from camtopod.records import Topology

NORTH, SOUTH = part_of("north"), part_of("south")
BORDER = DISTRICTS["north"].hears[0]


def test_a_city_has_its_parts_whole() -> None:
    city = merge([SOUTH, NORTH], DISTRICTS, "town").topology

    assert decode_topology(to_json(city)) == city
    assert (city.site, city.parts, city.owners) == ("town", [NORTH, SOUTH], OWNERS)
    assert (city.as_of, city.events) == (NORTH.as_of, NORTH.events + SOUTH.events)


def test_the_digest_tells_parts_and_owners_apart() -> None:
    digests = {
        digest_of([NORTH, SOUTH], OWNERS),
        digest_of([NORTH, replace(SOUTH, version=2)], OWNERS),
        digest_of([NORTH, replace(SOUTH, digest="sha256:0")], OWNERS),
        digest_of([NORTH, SOUTH], {**OWNERS, BORDER: "north"}),
    }

    assert len(digests) == 4
    assert merge([SOUTH, NORTH], DISTRICTS, "town").topology.digest in digests


@pytest.mark.parametrize(
    ("parts", "districts", "sentence"),
    [
        (
            [NORTH],
            DISTRICTS,
            "of the site south there are 0 topologies and 1 district: one of each",
        ),
        (
            [SOUTH, NORTH, SOUTH],
            DISTRICTS,
            "of the site south there are 2 topologies and 1 district: one of each",
        ),
        (
            [NORTH, SOUTH, replace(SOUTH, site="east", cameras=[])],
            DISTRICTS,
            "of the site east there are 1 topology and 0 districts: one of each",
        ),
        (
            [NORTH, SOUTH],
            {**DISTRICTS, "north": without(DISTRICTS["north"], BORDER)},
            f"north has a camera {BORDER}, which is south's and which north does not hear: a name "
            "is one camera's",
        ),
        (
            [
                NORTH,
                replace(SOUTH, cameras=[*SOUTH.cameras, replace(SOUTH.cameras[0], id="new")]),
            ],
            DISTRICTS,
            "south has a camera new, which no district owns",
        ),
        (
            [replace(NORTH, cameras=[c for c in NORTH.cameras if c.id != BORDER]), SOUTH],
            DISTRICTS,
            f"north has not learned from {BORDER} of south, which it should hear: this side of the "
            "border is missing",
        ),
        (
            [NORTH, replace(SOUTH, parts=[CITY])],
            DISTRICTS,
            "the topology of south is a city itself",
        ),
    ],
)
def test_what_is_no_city_is_refused_in_words(
    parts: list[Topology], districts: dict[str, District], sentence: str
) -> None:
    with pytest.raises(ValueError, match=r"north|south|east") as refused:
        merge(parts, districts, "town")

    assert str(refused.value) == sentence


def city() -> Topology:
    return merge([NORTH, SOUTH], DISTRICTS, "town").topology


@pytest.mark.parametrize(
    ("broken", "problem"),
    [
        (replace(city(), parts=[NORTH, NORTH]), "two parts are of one site"),
        (replace(city(), owners={}), "no part owns 'cam0000'"),
        (replace(city(), owners={**OWNERS, "cam0000": "south"}), "no part owns 'cam0000'"),
        (replace(city(), parts=[NORTH, replace(SOUTH, parts=[NORTH])]), "it is a city itself"),
        (
            replace(city(), parts=[NORTH, replace(SOUTH, zones=[])]),
            "there is no .* of `..parts.1.`",
        ),
    ],
)
def test_a_file_that_is_no_city_is_rejected(broken: Topology, problem: str) -> None:
    with pytest.raises(Rejected, match=problem):
        decode_topology(to_json(broken))
