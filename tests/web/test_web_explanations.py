"""The page's texts about cameras, pairs, links and versions."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from synthetic_topology import BINS, SHARE, made_link, synthetic_topology

from camtopod.records import Lacks, Link, Pair, Topology
from camtopod.web.explanations import Explanations, why, why_pair
from camtopod.web.version_diff import Change, changes, summary

SITE = synthetic_topology(12)
LINK = next(link for link in SITE.links if link.relation == "unseen")
STORIES = Explanations(SITE)


def told(link: Link, topology: Topology = SITE) -> dict[str, Any]:
    story = Explanations(topology).link(link.from_, link.to, link.relation)
    assert story is not None
    return story


def with_links(*links: Link, version: int = 2) -> Topology:
    return msgspec.structs.replace(SITE, version=version, links=list(links))


# --- a link
# -----------------------------------------------------------------------------------------


def test_a_links_chart_holds_all_transitions_and_the_same_samples_each_time() -> None:
    chart = told(LINK)["chart"]
    assert sum(chart["counts"]) == pytest.approx(LINK.transitions, rel=0.02)
    assert sum(chart["curve"]) == pytest.approx(LINK.transitions, rel=0.02)
    edges = [
        chart["scale"] * math.sinh(chart["step"] * (chart["first"] + k))
        for k in range(len(chart["counts"]) + 1)
    ]
    assert edges[0] < LINK.transit.q10 < LINK.transit.q90 < edges[-1]
    density = np.array(chart["curve"]) / np.diff(edges)
    assert edges[int(density.argmax())] == pytest.approx(LINK.transit.mode, rel=0.2)
    samples = chart["samples"]
    assert samples == told(LINK)["chart"]["samples"]
    assert np.median(samples) == pytest.approx(LINK.transit.q50, rel=0.15)
    assert BINS.lag_min <= min(samples) <= max(samples) <= BINS.lag_max


def test_a_link_tells_its_background_and_why_it_is_believed() -> None:
    story = told(LINK)
    assert SITE.model is not None
    departures = next(one.departures for one in SITE.model.zones if one.zone == LINK.from_)
    assert story["departures"] == departures
    assert story["background"] == pytest.approx(departures * 0.002)
    said = " ".join(story["why"])
    assert f"Of {departures:,} objects that left at {LINK.from_}" in said
    assert f"{SHARE:.0%}".replace("%", " %") in said
    assert "less than one in a million would be spurious" in said
    assert "Var(d) = 0.02" in said
    assert "not published" not in said


def test_the_words_follow_the_figures() -> None:
    overlapped = made_link("a/1", "b/1", -1.5, 90.0, overlapped=True)
    assert "before they leave at a/1" in " ".join(why(overlapped, False, None, None))
    seen = made_link("a/1", "a/2", 9.0, 90.0, visible=True)
    assert "in one view" in why(seen, False, None, None)[0]
    unsure = msgspec.structs.replace(LINK, q_value=0.04, mahalanobis_variance=0.5)
    said = " ".join(why(unsure, True, None, None))
    assert "about one in 25 would be spurious" in said
    assert "50 % of that of unrelated events" in said
    assert (
        "It is not published: not all rules for that are met yet (among them q ≤ 0.01 and 3.0 %"
        in said
    )
    assert "lacks" not in said
    lacking = msgspec.structs.replace(unsure, lacks=Lacks(12.0, 1800.0))
    assert "It lacks about 12 more passages, 30 minutes at this traffic." in " ".join(
        why(lacking, True, None, None)
    )


def test_a_weak_link_without_a_histogram_has_no_chart() -> None:
    weak = msgspec.structs.replace(LINK, histogram=None)
    story = told(weak, msgspec.structs.replace(SITE, links=[], weak_links=[weak]))
    assert (story["weak"], story["chart"]) == (True, None)


def test_what_is_not_there_is_none() -> None:
    assert STORIES.link("cam0000/1", "nowhere/1", "unseen") is None
    assert STORIES.camera("nowhere") is None
    assert STORIES.pair("cam0000", "cam0000") is None
    assert STORIES.pair("cam0000", "nowhere") is None


def test_a_topology_without_a_model_is_told_without_background() -> None:
    bare = msgspec.structs.replace(SITE, model=None)
    assert (told(LINK, bare)["background"], told(LINK, bare)["chart"]) == (None, None)
    camera = Explanations(bare).camera("cam0001")
    assert camera is not None
    assert camera["zones"][0]["arrival_rate"] is None


# --- a camera, a pair
# -------------------------------------------------------------------------------


def test_a_camera_has_its_zones_links_and_alarms_and_no_others() -> None:
    camera = STORIES.camera("cam0000")
    assert camera is not None
    assert {zone["camera"] for zone in camera["zones"]} == {"cam0000"}
    expected = [
        link
        for link in SITE.links
        if any(end.startswith("cam0000/") for end in (link.from_, link.to))
    ]
    assert len(camera["links"]) == len(expected) > 0
    assert not any("histogram" in link for link in camera["links"])
    assert [alarm.kind for alarm in camera["alarms"]] == ["camera_silent"]
    other = STORIES.camera("cam0001")
    assert other is not None
    assert other["alarms"] == []


def test_a_pair_has_the_links_of_both_ways() -> None:
    pair = SITE.pairs[0]
    story = STORIES.pair(*pair.cameras[::-1])
    assert story is not None
    assert (story["cameras"], story["relation"]) == (list(pair.cameras), pair.relation)
    assert {(link["from"].split("/")[0], link["to"].split("/")[0]) for link in story["links"]} == {
        pair.cameras,
        pair.cameras[::-1],
    }


def test_a_pair_says_what_its_two_tests_say() -> None:
    both = Pair(("a", "b"), "overlapped", "overlapped", "overlapped")
    assert "Both tests agree" in why_pair(both)[1]
    differ = msgspec.structs.replace(both, by_sum_rule="unseen_path", reason="few were counted")
    assert "no camera sees" in why_pair(differ)[2]
    assert "few were counted" in why_pair(differ)[-1]
    assert "could not be tested" in why_pair(msgspec.structs.replace(both, by_sum_rule=None))[2]
    assert "not sufficient" in why_pair(None)[0]


# --- versions
# ---------------------------------------------------------------------------------------


def test_a_version_that_is_the_same_has_no_changes() -> None:
    assert changes(SITE, msgspec.structs.replace(SITE, version=2)) == []


def test_changes_say_what_came_went_and_moved() -> None:
    rest = [link for link in SITE.links if link != LINK]
    shared = msgspec.structs.replace(rest[0], relation="unseen", probability=0.9)
    old = with_links(*rest[1:], msgspec.structs.replace(shared, probability=0.5), LINK)
    new = with_links(*rest[1:], shared, version=3)
    new = msgspec.structs.replace(
        new,
        pairs=[msgspec.structs.replace(SITE.pairs[0], relation="overlapped"), *SITE.pairs[2:]],
        zones=[msgspec.structs.replace(SITE.zones[0], x=0.5, y=0.9), *SITE.zones[1:]],
        cameras=[msgspec.structs.replace(SITE.cameras[0], clock_offset=4.0), *SITE.cameras[1:]],
    )
    old = msgspec.structs.replace(
        old, pairs=[msgspec.structs.replace(SITE.pairs[0], relation="unseen_path"), *SITE.pairs[1:]]
    )
    found = changes(old, new)
    before = f"unseen, share 45 %, {LINK.transit.q50:.1f} s before"
    assert Change("-", "link", [LINK.from_, LINK.to, "unseen"], before) in found
    assert Change("~", "link", [shared.from_, shared.to, "unseen"], "share 50 % → 90 %") in found
    assert [one.subject for one in found if (one.kind, one.sign) == ("pair", "-")] == [
        list(SITE.pairs[1].cameras)
    ]
    assert (
        Change("~", "pair", list(SITE.pairs[0].cameras), "an unseen path → overlapping views")
        in found
    )
    assert any(one.kind == "zone" and one.text.startswith("moved by") for one in found)
    assert Change("~", "clock", [SITE.cameras[0].id], "clock +0.0 s → +4.0 s") in found
    opposite = changes(new, old)
    assert {one.sign for one in opposite if one.subject[:2] == [LINK.from_, LINK.to]} == {"+"}


@pytest.mark.parametrize(
    ("seconds", "error", "said"), [(1.0, 0.1, False), (9.0, 0.1, True), (9.0, 5.0, False)]
)
def test_a_time_has_changed_when_it_is_more_than_its_errors(
    seconds: float, error: float, said: bool
) -> None:
    was = msgspec.structs.replace(
        LINK, transit=msgspec.structs.replace(LINK.transit, q50=40.0, q50_sd=error)
    )
    now = msgspec.structs.replace(
        was, transit=msgspec.structs.replace(was.transit, q50=40.0 + seconds)
    )
    assert bool(changes(with_links(was), with_links(now))) is said


def test_a_summary_counts_links_between_views_and_has_the_versions_own_alarms() -> None:
    one = summary(SITE)
    assert (one.cameras, one.pairs) == (12, len(SITE.pairs))
    assert one.links == sum(link.relation != "visible" for link in SITE.links) < len(SITE.links)
    assert len(one.alarms) == 1
    assert summary(msgspec.structs.replace(SITE, version=2)).alarms == []
