"""Walks: each entry continues one earlier passage at most, with probabilities that sum to 1."""

from __future__ import annotations

from typing import Any

import frigate_messages as says
import naive
import numpy as np
import pytest
from model_rows import LabelModel, with_rows
from msgspec.structs import replace
from serving import T0, walkers

from camtopod.adapt.frigate import Frigate
from camtopod.predict import PreparedVersion, Walks, outside_rates
from camtopod.predict.walk_graph import WalkEdge, WalkStep
from camtopod.predict.walk_memory import MEMORY_SECONDS, REVISE_SECONDS
from camtopod.predict.walks import REVISE_CHANGE, UNSEEN_IN_VIEW
from camtopod.records import (
    Event,
    Match,
    Topology,
)

T = T0 + 1e6
"""A time without other events."""


@pytest.fixture
def walks(learned: Topology) -> Walks:
    return Walks(learned)


def entry(camera: str, t: float, track: str | None) -> Event:
    return Event(camera, "entry", t, 0.12, 0.5, track)


def exit_(camera: str, t: float, track: str | None) -> Event:
    return Event(camera, "exit", t, 0.88, 0.5, track)


def matched(walks: Walks, events: list[Event]) -> list[Match]:
    return [match for event in events if (match := walks.observe(event)) is not None]


def test_an_entry_continues_the_passage_that_fits(walks: Walks) -> None:
    events = [entry("a", T, "1"), exit_("a", T + 4, "1"), entry("b", T + 13, "2")]
    first, second = matched(walks, events)
    assert first.walk == f"a@{T:.0f}"
    assert first.from_ == []
    assert first.new == 1.0
    assert (second.from_[0].camera, second.from_[0].track, second.from_[0].t) == ("a", "1", T + 4)
    assert second.from_[0].probability > 0.9
    assert second.walk == first.walk


def test_probabilities_sum_to_one(learned: Topology, walks: Walks) -> None:
    for match in matched(walks, walkers(200, seed=5)):
        assert match.new + sum(one.probability for one in match.from_) == pytest.approx(1.0)
        assert 0.0 <= match.new <= 1.0
        assert match.version == learned.version


def test_most_walks_are_right(walks: Walks) -> None:
    """Tracks of `walkers` are those of objects: an entry at b or c continues that at a."""
    matches = matched(walks, walkers(100, seed=7))
    later = [one for one in matches if one.camera != "a"]
    right = [one for one in later if one.from_ and one.from_[0].track == one.track]
    assert len(right) > 0.8 * len(later)


def test_one_passage_has_one_successor(walks: Walks) -> None:
    """The second of two entries cannot continue the passage that the first one continues."""
    events = [exit_("a", T, "1"), entry("b", T + 9, "2")]
    alone = matched(walks, events)[-1]
    later = matched(walks, [entry("c", T + 9.5, "3")])[0]
    assert alone.from_[0].probability > 0.9
    assert later.new > 0.5
    assert later.walk != alone.walk


def test_two_entries_at_one_instant_may_be_of_one_object(walks: Walks) -> None:
    """Learned is the direction from the entry that comes second to the first."""
    events = [entry("a", T, "1"), entry("b", T, "2"), entry("b", T + 0.1, "3")]
    a, b = (walks._prepared_version.zone_of(event) for event in events[:2])
    assert a is not None
    assert b is not None
    hazards = walks._hazards
    hazards._entry, hazards._entry_to = np.array([[b], [a]], np.int32)
    hazards._entry_pairs = np.array([b * len(walks._prepared_version.zones) + a, -1])
    hazards._entry_kernels = np.array([[0.5], [0.0]]) * (np.arange(hazards.bins.size + 1) >= 0)

    first, second, later = matched(walks, events)
    assert first.from_ == []
    weight = 0.5 * walks._outside[b] / walks._outside[a]
    expected = weight / (weight + UNSEEN_IN_VIEW * walks._outside[b])
    assert [one.probability for one in second.from_] == [pytest.approx(expected)]
    assert second.walk == first.walk
    assert later.from_ == []


def test_a_later_entry_changes_an_earlier_match(walks: Walks) -> None:
    """A match is given once more if a later entry fits its passage better, and never again."""
    matched(walks, [exit_("a", T, "1")])
    early = matched(walks, [entry("b", T + 6.6, "2")])[0]
    assert early.walk == f"a@{T:.0f}"
    matched(walks, [entry("c", T + 9, "3")])
    assert walks.revised(T + 6.6 + REVISE_SECONDS - 0.1) == []

    [again] = walks.revised(T + 6.6 + REVISE_SECONDS)
    assert again.from_[0].probability < early.from_[0].probability - REVISE_CHANGE
    assert walks.revised(T + 1000) == []


def test_passages_without_tracks_are_tied_by_dwell_times(walks: Walks) -> None:
    events = [
        entry("a", T, None),
        exit_("a", T + 4.5, None),
        entry("b", T + 13.5, None),
        exit_("b", T + 18, None),
    ]
    first, second = matched(walks, events)
    assert second.walk == first.walk
    assert second.track is None
    assert second.from_[0].t == T + 4.5


def test_two_walks_of_one_instant_have_two_names(walks: Walks) -> None:
    first, second = matched(walks, [entry("a", T + 0.25, "1"), entry("a", T + 0.25, "2")])
    assert first.walk == f"a@{T:.0f}.25"
    assert second.walk == f"a@{T:.0f}.25/2"


def remembered(walks: Walks) -> list[WalkStep]:
    """Return the passages of the events that are remembered, oldest first."""
    return [step for _, step in (*walks._memory._past_events, *walks._memory._events)]


def test_what_cannot_be_continued_any_more_has_but_its_name(walks: Walks) -> None:
    events = [entry("a", T, "1"), exit_("a", T + 4, "1"), entry("b", T + 13, "3")]
    first, second = matched(walks, [*events, exit_("b", T + 17, "3")])
    walks.observe(entry("c", T + 17 + walks._hazards.lag_max + REVISE_SECONDS, "4"))
    assert all(step.edges for step in remembered(walks)[2:4])
    assert walks.revised(T + 20 + walks._hazards.lag_max + 2 * REVISE_SECONDS) == []

    steps = remembered(walks)[:4]
    assert [step.walk for step in steps] == 2 * [first.walk] + 2 * [second.walk]
    assert not any(step.edges or step.claims or step.expected for step in steps)
    assert not any(walks._memory.steps_by_exit.values())


def test_passages_are_forgotten_after_an_hour(walks: Walks) -> None:
    events = [entry("a", T, "1"), exit_("a", T + 4, "1"), entry("a", T + 5, "2")]
    matched(walks, events)
    matched(walks, [entry("b", T + 5 + MEMORY_SECONDS + 1, "3")])
    assert len(remembered(walks)) == len(walks._memory.recent) == 1
    assert not walks._memory.open.of("a")
    assert not any(walks._memory.steps_by_exit.values())


def test_a_passage_is_remembered_from_its_last_event_on(walks: Walks) -> None:
    """A match that waits to be looked at again may have a passage that is forgotten meanwhile."""
    [first] = matched(walks, [entry("a", T, "1"), exit_("a", T + MEMORY_SECONDS - 5, "1")])
    [late] = matched(walks, [entry("b", T + MEMORY_SECONDS + 4, "3")])
    assert late.from_[0].track == "1"
    assert late.walk == first.walk
    walks.revised(T + 2 * MEMORY_SECONDS - 4)  # that passage is forgotten, its successor is not
    assert [step.track for step in remembered(walks)] == ["3"]


def test_a_walk_is_named_by_its_oldest_passage_of_the_last_hour(walks: Walks) -> None:
    """Nothing tells where a walk was before that."""
    [first] = matched(walks, [entry("a", T, "1"), exit_("a", T + 4, "1")])
    [second] = matched(walks, [entry("b", T + 13, "3")])
    assert second.walk == first.walk

    matched(walks, [entry("c", T + 4 + MEMORY_SECONDS, "4")])
    step = walks._memory.open.of("b")["3"]
    assert step.walk == first.walk
    matched(walks, [entry("c", T + 4.5 + MEMORY_SECONDS, "5")])
    assert step.walk == f"b@{T + 13:.0f}"


def test_what_came_after_a_forgotten_camera_begins_a_walk(walks: Walks) -> None:
    [first] = matched(walks, [entry("a", T, "1"), exit_("a", T + 4, "1")])
    [second] = matched(walks, [entry("b", T + 13, "3"), exit_("b", T + 17, "3")])
    assert second.walk == first.walk
    walks.forget_cameras({"b"})
    assert [step.walk for step in remembered(walks)] == [first.walk, first.walk]


def test_nothing_is_left_of_a_forgotten_camera(walks: Walks) -> None:
    """Two walks begin at a, one of which goes on at b."""
    matched(walks, [entry("a", T, "1"), exit_("a", T + 4, "1"), entry("a", T + 5, "2")])
    events = [entry("b", T + 13, "3"), exit_("b", T + 17, "3")]
    [before] = matched(walks, events)
    walks.forget_cameras({"a"})

    assert before.walk == f"a@{T:.0f}"
    assert [(step.track, step.walk, step.edges) for step in remembered(walks)] == 2 * [
        ("3", f"b@{T + 13:.0f}", [])
    ]
    [new] = matched(walks, [entry("c", T + 13.5, "4")])
    assert new.from_ == []
    assert walks.revised(T + 1000) == []


def test_a_new_version_goes_on_with_the_walks(learned: Topology, walks: Walks) -> None:
    first = matched(walks, [entry("a", T, "1"), exit_("a", T + 4, "1")])[0]
    newer = replace(learned, version=learned.version + 1)
    after = Walks(newer)
    after.take_over(walks)
    second = matched(after, [entry("b", T + 13, "2")])[0]
    assert (second.walk, second.version) == (first.walk, newer.version)


def test_a_new_version_s_outlooks_are_computed_a_few_at_a_time(learned: Topology) -> None:
    """So nothing else waits for long; the match is the one that would have been made at once."""
    events = [
        event
        for k in range(7)
        for event in (entry("a", T + k, f"{k}"), exit_("a", T + k + 0.5, f"{k}"))
    ]
    last = entry("b", T + 13, "last")
    before, at_once, in_steps = Walks(learned), Walks(learned), Walks(learned)
    for walks in (before, at_once):
        matched(walks, events)
    in_steps.take_over(before)

    def computed() -> int:
        return sum(step.expected is not None for step in in_steps._memory.steps())

    counts = [computed()]
    while not in_steps.prepare(last, 3):
        counts.append(computed())
    assert [*counts, computed()] == [0, 3, 6, 7]
    assert in_steps.prepare(exit_("b", T + 14, "last"), 3)
    assert in_steps.observe(last) == at_once.observe(last)


def test_the_rates_from_outside_may_be_given(learned: Topology) -> None:
    """The learner's process computes them, for the daemon."""
    given = Walks(learned, outside=outside_rates(PreparedVersion(learned)).tolist())
    events = [entry("a", T, "1"), exit_("a", T + 4, "1"), entry("b", T + 13, "2")]
    assert matched(given, events) == matched(Walks(learned), events)


def test_marginals_are_exact_where_the_graph_is_a_tree(walks: Walks) -> None:
    """Two entries with one candidate in common: sum-product equals enumeration."""
    weights = np.array([[0.3, 0.0], [0.5, 0.4], [0.0, 0.2]])
    outside = np.array([0.1, 0.2])
    sources = [WalkStep("a", str(k), T, f"a{k}", 0, T) for k in range(3)]
    entries = [WalkStep("b", str(k), T, f"b{k}", 0, T) for k in range(2)]
    for k, one in enumerate(entries):
        one.outside = float(outside[k])
        for x, source in enumerate(sources):
            if weights[x, k]:
                WalkEdge(source, one, "b", float(weights[x, k])).add()
    for one in (*entries, entries[0]):
        walks._settle(one, T)

    found = np.zeros((3, 2))
    for k, one in enumerate(entries):
        for edge in one.edges:
            found[sources.index(edge.source), k] = edge.probability
    exact = naive.matching_marginals(weights, np.full(3, UNSEEN_IN_VIEW), outside)
    np.testing.assert_allclose(found, exact, rtol=1e-3)


def test_an_exit_may_be_told_after_the_entry_that_continues_it(walks: Walks) -> None:
    """Trackers tell an exit seconds late, once the object has not been found again."""
    told = [entry("a", T, "1"), entry("b", T + 13, "2"), exit_("a", T + 4, "1")]
    before = matched(walks, told)[1]
    assert (before.from_, before.new) == ([], 1.0)

    [after] = walks.revised(T + 13 + REVISE_SECONDS)
    assert (after.camera, after.t, after.walk) == ("b", T + 13, f"a@{T:.0f}")
    assert (after.from_[0].track, after.from_[0].t) == ("1", T + 4)
    assert after.new + sum(one.probability for one in after.from_) == pytest.approx(1.0)
    assert after.from_[0].probability > 0.9


def test_tracks_are_the_ids_of_the_events_of_frigate(walks: Walks) -> None:
    frigate = Frigate({"": (says.WIDTH, says.HEIGHT)})
    at_a, at_b = says.passage(1, T, "a"), says.passage(2, T + 17.2, "b")
    events = [event for line in [*at_a, *at_b] for event in frigate.receive(line)]

    match = matched(walks, events)[-1]
    assert match.track == f"{T + 17.2}-000002"
    assert match.from_[0].track == f"{T}-000001"
    assert match.from_[0].probability > 0.9


def with_labels(topology: Topology, persistence: float = 0.95) -> Topology:
    """Return the version with labels: nine in ten are cars, the others buses."""
    assert topology.model is not None
    shares = {zone.id: [0.1, 0.9] for zone in topology.zones}
    labels = LabelModel(["bus", "car"], persistence, shares)
    return with_rows(topology, labels=labels)


def test_of_two_passages_that_fit_the_one_with_the_same_label_goes_on(learned: Topology) -> None:
    """The exit has its entry's label, and a new version goes on with it."""
    link = max(
        (one for one in learned.links if one.relation == "unseen"), key=lambda one: one.probability
    )
    here, there = (name.rpartition("/")[0] for name in (link.from_, link.to))
    zones = {zone.id: zone for zone in learned.zones}

    def at(zone: str, kind: Any, t: float, track: str, label: str | None) -> Event:
        one = zones[zone]
        return Event(one.camera, kind, t, one.x, one.y, track, label=label)

    topology = with_labels(learned)
    walks = Walks(topology)
    for track, label in (("1", "car"), ("2", "bus")):
        walks.observe(at(link.from_, "entry", T, track, label))
        walks.observe(at(link.from_, "exit", T + 2.0, track, None))
    newer = Walks(topology)
    newer.take_over(walks)

    match = newer.observe(at(link.to, "entry", T + 2.0 + link.transit.q50, "9", "bus"))

    assert match is not None
    assert here != there
    chance = {one.track: one.probability for one in match.from_}
    assert chance["2"] > 0.7
    assert chance.get("1", 0.0) < 0.1
