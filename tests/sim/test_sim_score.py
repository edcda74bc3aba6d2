"""A topology made from the ground truth scores perfectly, a damaged one accordingly worse."""

from __future__ import annotations

import math

import msgspec
import pytest
from synthetic_events import topology_of

from camtopod.records import Event, NextCamera, Prediction
from camtopod.sim.scoring import next_entries, score, score_predictions
from camtopod.sim.simulation import SimSettings, simulate

EVENTS, TRUTH = simulate(SimSettings(cameras=6, hours=0.5))
PERFECT = topology_of(TRUTH)
replace = msgspec.structs.replace


def test_the_truth_is_perfect() -> None:
    result = score(PERFECT, TRUTH)
    assert result.cameras_right == result.cameras == 6
    assert result.zones_matched == result.zones_true == result.zones_learned
    assert (
        result.link_precision
        == result.link_recall
        == result.pair_precision
        == result.pair_recall
        == 1
    )
    assert result.relations_right == result.links_right == result.links_learned > 10
    assert result.mode_error == result.mean_error == 0
    assert "precision 1.00" in result.text()


def test_a_zone_out_of_place_is_not_found_and_its_links_are_false() -> None:
    zone = next(link.to for link in PERFECT.links if link.relation == "unseen")
    zones = [replace(z, x=(z.x + 0.5) % 1) if z.id == zone else z for z in PERFECT.zones]

    result = score(replace(PERFECT, zones=zones), TRUTH)

    assert result.zones_matched < result.zones_true
    assert result.link_precision < 1


def test_false_links_missing_links_and_wrong_relations_are_told_apart() -> None:
    links = [link for link in PERFECT.links if link.relation != "visible"]
    false = replace(
        links[0], to=next(z.id for z in PERFECT.zones if z.camera == links[0].from_.split("/")[0])
    )
    assert score(replace(PERFECT, links=[*PERFECT.links, false]), TRUTH).link_precision < 1
    fewer = score(replace(PERFECT, links=links[1:]), TRUTH)
    assert fewer.links_found == fewer.links_true - 1
    assert fewer.link_precision == 1
    flipped = {"unseen": "overlapped", "overlapped": "unseen"}
    other = score(
        replace(PERFECT, links=[replace(x, relation=flipped[x.relation]) for x in links]), TRUTH
    )
    assert other.relations_right == 0
    assert other.link_precision == 1


def test_without_positions_a_camera_is_one_zone() -> None:
    zones = [
        replace(z, id=f"{z.camera}/1", x=None, y=None, cov=None)
        for z in PERFECT.zones
        if z.id.endswith("/1")
    ]
    whole = {z.camera for z in zones}
    links = {}
    for link in PERFECT.links:
        a, b = link.from_.split("/")[0], link.to.split("/")[0]
        if link.relation != "visible":
            links[a, b] = replace(link, from_=f"{a}/1", to=f"{b}/1")
    result = score(replace(PERFECT, zones=zones, links=list(links.values())), TRUTH)
    assert whole == set(TRUTH.cameras)
    assert result.link_precision == result.link_recall == 1


def test_nothing_learned_is_no_division_by_zero() -> None:
    result = score(replace(PERFECT, zones=[], links=[], pairs=[]), TRUTH)
    assert result.link_recall == result.pair_recall == 0
    assert math.isnan(result.mode_error)
    assert "error -" in result.text()


def naive_next_entry(index: int) -> int:
    """Search all events for the walker's later passages (slow version)."""
    who, number = TRUTH.identity[index], TRUTH.passage[index]
    if who < 0 or EVENTS[index].kind == "entry":
        return -1
    later = [
        (TRUTH.passage[j], j)
        for j, event in enumerate(EVENTS)
        if TRUTH.identity[j] == who and event.kind == "entry" and TRUTH.passage[j] > number
    ]
    return min(later)[1] if later else -1


def test_next_entries_equal_the_naive_search() -> None:
    following = next_entries(EVENTS, TRUTH)
    assert following[:300] == [naive_next_entry(i) for i in range(300)]
    assert sum(j >= 0 for j in following) > 100


def knowing(certain: float) -> list[Prediction]:
    """Return predictions that give ``certain`` to the true outcome and the rest elsewhere."""
    result = []
    for event, j in zip(EVENTS, next_entries(EVENTS, TRUTH), strict=True):
        if event.kind == "exit":
            result.append(prediction(event, EVENTS[j].camera if j >= 0 else None, certain))
    return result


def prediction(event: Event, camera: str | None, certain: float) -> Prediction:
    shares = {"elsewhere": 1 - certain, camera or "leave": certain}
    leave = shares.pop("leave", 0.0)
    choices = [
        NextCamera(c, f"{c}/1", p, 1, 2, 3)
        for c, p in sorted(shares.items(), key=lambda item: -item[1])
    ]
    return Prediction(event.camera, None, event.t, event.track, 1, leave, choices)


def test_predictions_are_scored_by_what_happened() -> None:
    sure = score_predictions(knowing(1.0), EVENTS, TRUTH)
    assert (sure.top1, sure.top3, sure.log_loss) == (1, 1, 0)
    assert sure.exits == sum(
        e.kind == "exit" and who >= 0 for e, who in zip(EVENTS, TRUTH.identity, strict=True)
    )
    unsure = score_predictions(knowing(0.4), EVENTS, TRUTH)
    assert (unsure.top1, unsure.top3) == (0, 1)
    assert unsure.log_loss == pytest.approx(-math.log(0.4))
    assert "next camera right 0.000" in unsure.text()
    late = score_predictions(knowing(1.0), EVENTS, TRUTH, since=EVENTS[len(EVENTS) // 2].t)
    assert 0 < late.exits < sure.exits


def test_predictions_for_other_events_are_refused() -> None:
    with pytest.raises(ValueError, match="is not for exit line"):
        score_predictions(knowing(1.0)[::-1], EVENTS, TRUTH)
    with pytest.raises(ValueError, match="shorter"):
        score_predictions(knowing(1.0)[:-1], EVENTS, TRUTH)
