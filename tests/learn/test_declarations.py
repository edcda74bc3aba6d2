"""What a user declares of the site weighs the evidence, and shapes fits and predictions."""

from __future__ import annotations

import random

import numpy as np
import pytest
from msgspec.structs import replace

from camtopod.cli.commands.learn import link_table
from camtopod.learn.declarations import declared_by, forgotten, taken_back, zone_weights
from camtopod.learn.links.significance import q_values
from camtopod.learn.recording import learn_topology
from camtopod.learn.settings import Settings, TopologySettings
from camtopod.predict import Departure, Predictor, Walks, log_density, outlook
from camtopod.records import Declared, Event, Topology
from camtopod.topology import LEAVE_FLOOR

T0 = 1_700_000_000.0
NAMES = ["a", "b", "c", "d"]


def test_declarations_follow_names_that_were_changed() -> None:
    given = TopologySettings((("b", "a"), ("c", "d"), ("a", "nobody")), (("old", "d"), ("a", "c")))
    names = {"old": "a", "c": ""}
    assert declared_by(given, names, NAMES) == Declared([("a", "b")], [("a", "d")])


def test_pairs_that_renaming_has_made_one_are_neighbours_or_none() -> None:
    given = TopologySettings((("a", "b"),), (("old", "b"), ("old", "a")))
    assert declared_by(given, {"old": "a"}, NAMES) == Declared([("a", "b")], [])


def test_a_forgotten_camera_takes_its_old_names_along() -> None:
    names = forgotten({"old": "a", "x": "b"}, "a")
    assert names == {"old": "", "x": "b", "a": ""}
    assert taken_back(names, "a") == {"old": "", "x": "b"}


def test_weights_of_pairs_of_zones_have_a_mean_of_1() -> None:
    declared = Declared([("a", "b")], [("a", "c")])
    view = np.array([0, 0, 1, 2, 3, 3], np.int32)
    weights = zone_weights(declared, NAMES, view)
    assert weights is not None
    assert weights.mean() == pytest.approx(1.0)
    assert weights[0, 2] == pytest.approx(10.0 * weights[0, 4])
    assert weights[3, 1] == pytest.approx(0.1 * weights[4, 0])


def test_weights_keep_the_false_discovery_rate_and_find_more_of_what_was_declared() -> None:
    """Without any link, no more than 5 % of the runs have one; with links, more are found."""
    rng = np.random.default_rng(7)
    declared = Declared([("a", "b")], [("a", "c"), ("a", "d"), ("b", "c"), ("b", "d")])
    weights = zone_weights(declared, NAMES, np.repeat(np.arange(4, dtype=np.int32), 3))
    assert weights is not None
    weight, runs = weights.ravel(), 3_000
    chance = -np.log(rng.random((runs, len(weight))))
    false = [(q_values(one, len(weight), weight) <= 0.05).any() for one in chance]
    assert np.mean(false) <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / runs)

    joined = weight == weight.max()
    found = [
        (q_values(one + 4.0 * joined, len(weight), by) <= 0.05)[joined].mean()
        for by in (weight, np.ones(len(weight)))
        for one in chance[:300]
    ]
    assert np.mean(found[:300]) > 1.3 * np.mean(found[300:])


def site(seed: int = 1, both: float = 0.7, count: int = 300) -> list[Event]:
    """Return events of objects that leave a and appear 8 s later at b, or 11 s later at c.

    both: share of the objects that appear at b. Others come to d, from outside.
    """
    chance = random.Random(seed)
    events, t = [], T0
    for _ in range(count):
        t += chance.expovariate(1 / 20)
        to, lag = ("b", 8.0) if chance.random() < both else ("c", 11.0)
        events.append(Event("a", "exit", t))
        events.append(Event(to, "entry", t + chance.gauss(lag, 0.7)))
        events.append(Event("d", "entry", T0 + chance.random() * 20 * count))
    return sorted(events, key=lambda event: event.t)


def learned(events: list[Event], **declared: object) -> Topology:
    known = TopologySettings(**declared)  # type: ignore[arg-type]
    return learn_topology(events, Settings(topology=known))


def test_strong_evidence_against_a_declaration_is_published_and_marked() -> None:
    topology = learned(site(), neighbours=(("a", "b"),), not_neighbours=(("c", "a"),))
    marks = {(link.from_, link.to): link.contradicted for link in topology.links}
    assert marks == {("a/1", "b/1"): False, ("a/1", "c/1"): True}
    rows = [row for row in link_table(topology) if row.endswith(", contradicts not_neighbours")]
    assert [row.split()[:2] for row in rows] == [["a/1", "c/1"]]


def test_declared_neighbours_without_passages_are_not_published() -> None:
    topology = learned(site(), neighbours=(("a", "d"), ("b", "d")))
    assert {(link.from_, link.to) for link in topology.links} == {("a/1", "b/1"), ("a/1", "c/1")}
    assert topology.model is not None
    assert topology.model.declared == Declared([("a", "d"), ("b", "d")])


def test_who_cannot_go_somewhere_is_hardly_expected_there() -> None:
    """Of few passages, the shares follow what was declared: weak evidence is all there is."""
    events = site(seed=3, both=0.5, count=12)
    chance = {}
    for apart in ((), (("a", "c"),), (("a", "d"),)):
        topology = learned(events, not_neighbours=apart)
        prediction = Predictor(topology).predict(Event("a", "exit", events[-1].t + 3600.0))
        by_camera = dict.fromkeys(NAMES, 0.0)
        for one in prediction.next:
            by_camera[one.camera] += one.probability
        chance[apart] = by_camera
    assert chance[("a", "d"),]["d"] < 0.5 * chance[()]["d"]
    assert chance[("a", "c"),]["c"] < chance[()]["c"]


def test_nothing_declared_leaves_everything_as_it_is() -> None:
    events = site(count=60)
    assert learned(events).digest == learn_topology(events).digest


def test_who_does_not_leave_is_somewhere() -> None:
    """Nobody is said to leave a closed site, whenever it is asked for, nor by its outlook."""
    topology = learned(site(both=0.5, count=100), nobody_leaves=True)
    predictor = Predictor(topology)
    left = Event("d", "exit", T0 + 1e5)
    for event, now in ((left, None), (left, left.t + 30.0), (left, left.t + 4000.0)):
        prediction = predictor.predict(replace(event, camera="a"), now)
        assert prediction.leave <= LEAVE_FLOOR + 1e-9
        assert prediction.leave + sum(one.probability for one in prediction.next) == (
            pytest.approx(1.0, abs=2e-3)
        )

    prepared = predictor.prepared
    answer = outlook(prepared, Departure(0))
    longest = prepared.hazards.bins.lag_max
    unseen = answer.unseen(np.array([0.0, 0.5 * longest, longest, np.inf]))
    assert unseen[-1] <= LEAVE_FLOOR + 1e-9
    assert unseen.tolist() == sorted(unseen, reverse=True)
    at = np.arange(len(topology.zones))
    density = log_density(prepared, answer, at[1:], np.full(3, 0.9 * longest))
    assert np.isfinite(density).all()
    assert np.isneginf(log_density(prepared, answer, at, np.full(4, longest + 1.0))).all()


def test_who_is_lost_on_a_closed_site_may_be_anyone_who_enters() -> None:
    """At a lag that no link has, an entry may continue a passage only where nobody leaves."""
    events = site(both=0.5, count=100)
    chances = []
    for closed in (False, True):
        walks = Walks(learned(events, nobody_leaves=closed))
        walks.observe(Event("a", "entry", T0 + 1e5, track="1"))
        walks.observe(Event("a", "exit", T0 + 1e5 + 5.0, track="1"))
        match = walks.observe(Event("d", "entry", T0 + 1e5 + 60.0, track="2"))
        assert match is not None
        chances.append(sum(one.probability for one in match.from_))
    assert chances[1] > chances[0]
    assert chances[1] > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_cameras_that_nothing_joins_have_no_links_whatever_was_declared(seed: int) -> None:
    chance = random.Random(seed)
    events = [
        Event(camera, kind, T0 + chance.random() * 1800.0)
        for camera in NAMES
        for kind in ("entry", "exit")
        for _ in range(150)
    ]
    topology = learned(events, neighbours=(("a", "b"), ("c", "d")), not_neighbours=(("a", "c"),))
    assert [link for link in topology.links if link.relation != "visible"] == []
