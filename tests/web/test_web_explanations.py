"""The page's texts about cameras, pairs, links and versions."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from synthetic_topology import BINS, made_link, synthetic_topology

from camtopod.records import Camera, Lacks, Link, Pair, Topology
from camtopod.web.explanations import Explanations, why, why_pair
from camtopod.web.map_data import map_edges
from camtopod.web.versions import summary

SITE = synthetic_topology(12)
LINK = next(link for link in SITE.links if link.relation == "unseen")


def details_of(link: Link, topology: Topology = SITE) -> dict[str, Any]:
    details = Explanations(topology).link(link.from_, link.to, link.relation)
    assert details is not None
    return details


# --- a link


def test_a_links_chart_holds_all_transitions_and_the_same_samples_each_time() -> None:
    chart = details_of(LINK)["chart"]

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
    assert samples == details_of(LINK)["chart"]["samples"]
    assert np.median(samples) == pytest.approx(LINK.transit.q50, rel=0.15)
    assert BINS.lag_min <= min(samples) <= max(samples) <= BINS.lag_max


def test_the_words_follow_the_figures() -> None:
    overlapped = made_link("a/1", "b/1", -1.5, 90.0, overlapped=True)

    assert "before they leave at a/1" in " ".join(why(overlapped, False, None, None))
    seen = made_link("a/1", "a/2", 9.0, 90.0, visible=True)
    assert "in one view" in why(seen, False, None, None)[0]
    unsure = msgspec.structs.replace(LINK, q_value=0.04, mahalanobis_variance=0.5)
    said = " ".join(why(unsure, True, None, None))
    assert "about one in 25 would be spurious" in said
    assert "50 % of that of unrelated events" in said
    assert "It is not published: it does not meet all of the rule for that yet" in said
    assert "lacks" not in said
    lacking = msgspec.structs.replace(unsure, lacks=Lacks(12.0, 1800.0))
    assert "It lacks about 12 more passages, about half an hour at this traffic." in " ".join(
        why(lacking, True, None, None)
    )
    assert "not_neighbours" not in said
    contradicted = msgspec.structs.replace(LINK, contradicted=True)
    assert "It contradicts not_neighbours" in why(contradicted, False, None, None)[-1]


# --- a camera, a pair


def test_a_link_of_a_recording_in_a_loop_claims_no_evidence() -> None:
    reason = "west repeats itself every 113.6 s: a recording in a loop?"
    links = [msgspec.structs.replace(link, provisional=reason) for link in SITE.links]
    looped = msgspec.structs.replace(SITE, links=links)
    zone = {zone.id: zone.camera for zone in SITE.zones}
    ends = sorted((zone[LINK.from_], zone[LINK.to]))

    assert details_of(LINK, looped)["why"][0] == reason
    assert not any("spurious" in said for said in details_of(LINK, looped)["why"])
    pair = Explanations(looped).pair(*ends)
    assert pair is not None
    assert (pair["provisional"], pair["why"]) == (reason, [])
    assert map_edges(looped)[" ".join(ends)].provisional == reason


def test_a_pair_says_what_its_two_tests_say() -> None:
    both = Pair(("a", "b"), "overlapped", "overlapped", "overlapped")

    assert "Both tests agree" in why_pair(both)[1]
    differ = msgspec.structs.replace(both, by_sum_rule="unseen_path", reason="few were counted")
    assert "no camera sees" in why_pair(differ)[2]
    assert "few were counted" in why_pair(differ)[-1]
    assert "could not be tested" in why_pair(msgspec.structs.replace(both, by_sum_rule=None))[2]
    assert "not sufficient" in why_pair(None)[0]


# --- versions


def test_a_summary_says_what_came_went_and_became_another() -> None:
    pair, gone, *rest = SITE.pairs
    other = {"overlapped": "unseen_path", "unseen_path": "overlapped"}[pair.relation]
    new = msgspec.structs.replace(
        SITE,
        version=2,
        cameras=[*SITE.cameras, Camera("new", [])],
        links=[link for link in SITE.links if link != LINK],
        pairs=[msgspec.structs.replace(pair, relation=other), *rest],
    )

    one = summary(new, SITE)
    back = summary(SITE, new)

    found = {(change.kind, change.subject): change for change in one["changes"]}
    words = ["overlapping views", "an unseen path"]
    assert (one["since"], one["changes_count"], len(found)) == (1, 4, 4)
    assert found["camera", ("new",)].before is None
    assert found["link", (LINK.from_, LINK.to, "unseen")].now is None
    assert found["pair", gone.cameras].now is None
    assert {found["pair", pair.cameras].before, found["pair", pair.cameras].now} == set(words)
    assert {change.subject for change in back["changes"]} == {subject for _, subject in found}
