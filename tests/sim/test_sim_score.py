"""A topology made from the ground truth scores perfectly, a damaged one accordingly worse."""

from __future__ import annotations

import math

import msgspec
from synthetic_events import topology_of

from camtopod.sim.scoring import score
from camtopod.sim.simulation import SimSettings, simulate

TRUTH = simulate(SimSettings(cameras=6, hours=0.5))[1]
PERFECT = topology_of(TRUTH)
LINKS = [link for link in PERFECT.links if link.relation != "visible"]
replace = msgspec.structs.replace


def test_the_truth_is_perfect() -> None:
    result = score(PERFECT, TRUTH)

    assert result.cameras_right == result.cameras == 6
    assert result.zones_matched == result.zones_true == result.zones_learned
    assert result.link_precision == result.link_recall == 1
    assert result.pair_precision == result.pair_recall == 1
    assert result.relations_right == result.links_right == result.links_learned > 10
    assert result.transit_error("mode") == result.transit_error("mean") == 0
    assert "precision 1.00" in result.text()


def test_a_zone_out_of_place_is_not_found_and_its_links_are_false() -> None:
    zone = next(link.to for link in LINKS if link.relation == "unseen")
    zones = [replace(z, x=(z.x + 0.5) % 1) if z.id == zone else z for z in PERFECT.zones]

    result = score(replace(PERFECT, zones=zones), TRUTH)

    assert result.zones_matched < result.zones_true
    assert result.link_precision < 1


def test_false_links_missing_links_and_wrong_relations_are_told_apart() -> None:
    here = LINKS[0].from_.split("/")[0]
    false = replace(LINKS[0], to=next(z.id for z in PERFECT.zones if z.camera == here))
    flipped = {"unseen": "overlapped", "overlapped": "unseen"}
    turned = [replace(link, relation=flipped[link.relation]) for link in LINKS]

    more = score(replace(PERFECT, links=[*LINKS, false]), TRUTH)
    fewer = score(replace(PERFECT, links=LINKS[1:]), TRUTH)
    other = score(replace(PERFECT, links=turned), TRUTH)

    assert more.link_precision < 1
    assert fewer.links_found == fewer.links_true - 1
    assert fewer.link_precision == other.link_precision == 1
    assert other.relations_right == 0


def test_without_positions_a_camera_is_one_zone() -> None:
    zones = [
        replace(zone, x=None, y=None, cov=None) for zone in PERFECT.zones if zone.id[-2:] == "/1"
    ]
    ends = {link: (link.from_.split("/")[0], link.to.split("/")[0]) for link in LINKS}
    links = [replace(link, from_=f"{a}/1", to=f"{b}/1") for link, (a, b) in ends.items()]

    result = score(replace(PERFECT, zones=zones, links=links), TRUTH)

    assert result.link_precision == result.link_recall == 1


def test_nothing_learned_is_no_division_by_zero() -> None:
    result = score(replace(PERFECT, zones=[], links=[], pairs=[]), TRUTH)

    assert result.link_recall == result.pair_recall == 0
    assert math.isnan(result.transit_error("mode"))
    assert "nan" not in result.text()
