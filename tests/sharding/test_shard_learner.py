"""Shards: any number gives the same topology; each receives little and finds new neighbours."""

from __future__ import annotations

import random
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import NewerSnapshot, SnapshotError
from camtopod.predict.predictor import Predictor
from camtopod.records import Event, Topology
from camtopod.sharding.assignment import Assignment, Sharding
from camtopod.sharding.district_learner import NEWCOMERS_MAX, District
from camtopod.sharding.parts import Part
from camtopod.sharding.shard_learner import ShardLearner, pack_shard, unpack_shard
from camtopod.sharding.version_line import VersionLine
from camtopod.sim.scoring import score, score_predictions
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import Truth

SETTINGS = Settings(refit_share=1.0)
SHARDING = Sharding(districts=4, guest_turns=3, turn_hours=0.05)
NUMBERS = range(SHARDING.districts)
Steps = list[tuple[list[Part], float | None]]


@lru_cache
def site() -> tuple[list[Event], Truth]:
    return simulate(SimSettings(seed=6, cameras=6, hours=0.32, objects_per_second=0.12))


@lru_cache
def shuffled(seed: int) -> list[Event]:
    """Return the events out of order within the lateness."""
    chance = random.Random(seed)
    return sorted(site()[0], key=lambda event: event.t + chance.uniform(0.0, 4.5))


def fed(learner: ShardLearner, events: list[Event]) -> ShardLearner:
    for event in events:
        learner.receive(event)
    learner.flush()
    return learner


def versions(made: list[Topology]) -> list[tuple[int, str]]:
    return [(one.version, one.digest) for one in made]


@lru_cache
def one_shard() -> ShardLearner:
    return fed(ShardLearner(SETTINGS, SHARDING, (0, 1), "s", "e"), site()[0])


@lru_cache
def expected() -> tuple[list[Topology], dict[int, list[Part]]]:
    """Return the versions of one shard, and the parts of each district."""
    learner = one_shard()
    parts: dict[int, list[Part]] = {number: [] for number in NUMBERS}
    for part in learner.parts():
        parts[part.district].append(part)
    return learner.updates(), parts


@lru_cache
def alone(number: int, seed: int) -> list[Part]:
    """Return what a district makes by itself of events in another order.

    0: in order, with the others.
    """
    if seed == 0:
        return expected()[1][number]
    district = District(SETTINGS, "s", "e", Assignment(SHARDING), number)
    for event in shuffled(seed):
        district.receive(event)
    district.flush()
    return district.parts()


def test_one_district_learns_as_a_learner_does() -> None:
    often = Settings(refit_share=0.6)
    plain, learner = (
        Learner(often, "s", "e"),
        ShardLearner(often, Sharding(districts=1), (0, 1), "s", "e"),
    )
    fed(learner, site()[0])
    for event in site()[0]:
        plain.receive(event)
    plain.flush()
    made = plain.updates()
    assert len(made) > 4
    assert versions(learner.updates()) == versions(made)


def test_the_same_topology_with_several_shards() -> None:
    shards = 2
    line = VersionLine(SETTINGS, "s", "e")
    learners = [
        ShardLearner(SETTINGS, SHARDING, (shard, shards), "s", "e") for shard in range(shards)
    ]
    for event in site()[0]:
        for learner in learners:
            learner.receive(event)
            line.take(learner.parts())
        reached = [mark for learner in learners if (mark := learner.reached()) is not None]
        if len(reached) == shards:
            line.reach(min(reached))
    for learner in learners:
        learner.flush()
        line.take(learner.parts())
    line.flush()
    made, _ = expected()
    assert len(made) >= 4
    assert versions(line.updates()) == versions(made)


@settings(max_examples=12)
@given(
    st.permutations(NUMBERS),
    st.lists(st.integers(0, 1), min_size=4, max_size=4),
    st.randoms(use_true_random=False),
)
def test_whoever_works_a_district_and_however_events_come(
    order: list[int], seeds: list[int], chance: random.Random
) -> None:
    """Separate districts, different orders of events and of parts: the result is the same."""
    told = [part for number in order for part in alone(number, seeds[number])]
    line, waiting = (
        VersionLine(SETTINGS, "s", "e"),
        sorted(told, key=lambda part: (part.topology.as_of, chance.random())),
    )
    for part, following in pairwise(waiting):
        line.take([part])
        line.reach(following.topology.as_of - 1.0)
    line.take(waiting[-1:])
    line.flush()
    made, parts = expected()
    assert {number: alone(number, seeds[number]) for number in NUMBERS} == parts
    assert versions(line.updates()) == versions(made)


def test_links_are_told_by_those_who_own_their_end() -> None:
    dealing, (_, parts) = Assignment(SHARDING), expected()
    foreign = 0
    for number, made in parts.items():
        for part in made:
            camera_of = {zone.id: zone.camera for zone in part.topology.zones}
            links = [*part.topology.links, *(part.topology.weak_links or [])]
            assert {dealing.district(camera_of[link.to]) for link in links} <= {number}
            assert {dealing.district(camera.id) for camera in part.topology.cameras} <= {number}
            assert {dealing.district(camera) for camera in part.rates} <= {number}
            foreign += sum(
                dealing.district(camera_of[link.from_]) != number for link in part.topology.links
            )
    assert foreign > 5


# With the default districts nearly every camera has one of its own, and all are in their first
# turn.
@pytest.mark.parametrize(
    ("sharding", "share"), [(Sharding(districts=4, guest_turns=1), 0.8), (Sharding(), 0.89)]
)
def test_it_is_about_as_good_as_one_learner(sharding: Sharding, share: float) -> None:
    events, truth = site()
    plain = Learner(SETTINGS)
    for event in events:
        plain.receive(event)
    plain.flush()
    merged = fed(ShardLearner(SETTINGS, sharding), events).topology
    assert plain.topology is not None
    assert merged is not None
    one, several = score(plain.topology, truth), score(merged, truth)
    assert several.links_found >= share * one.links_found > 8
    assert several.link_precision >= 0.9
    assert top1(merged) >= top1(plain.topology) - 0.05 > 0.5


def top1(topology: Topology) -> float:
    """Return the top-1 of the predictions for objects seen again."""
    events, truth = site()
    predictor, said = Predictor(topology), []
    for event in events:
        if event.kind == "exit":
            said.append(predictor.predict(event))
            assert said[-1].leave + sum(
                choice.probability for choice in said[-1].next_
            ) == pytest.approx(1.0)
        predictor.observe(event)
    return score_predictions(said, events, truth).top1


def test_a_snapshot_goes_on_as_if_nothing_had_been() -> None:
    """Taken and restored at random moments."""
    events, made = site()[0], expected()[0]
    learner, told = ShardLearner(SETTINGS, SHARDING, (0, 1), "s", "e"), []
    for number, event in enumerate(events):
        if number % 97 == 0:
            told += learner.updates()
            blob, statistics = pack_shard(learner.save()), learner.statistics()
            learner = ShardLearner(SETTINGS, SHARDING, (0, 1), "s", "e")
            learner.load(unpack_shard(blob))
            assert learner.statistics() == statistics
        learner.receive(event)
    learner.flush()
    assert versions(told + learner.updates()) == versions(made)


def test_a_snapshot_of_another_shard_is_refused() -> None:
    blob = pack_shard(one_shard().save())
    with pytest.raises(ValueError, match="shard"):
        ShardLearner(SETTINGS, SHARDING, (0, 2), "s", "e").load(unpack_shard(blob))
    with pytest.raises(SnapshotError):
        unpack_shard(blob[: len(blob) // 2])
    with pytest.raises(SnapshotError):
        unpack_shard(b"nothing")
    assert issubclass(NewerSnapshot, SnapshotError)


def test_a_new_epoch_begins_with_what_is_known() -> None:
    learner = ShardLearner(SETTINGS, SHARDING, (0, 1), "s", "e")
    learner.load(one_shard().save())
    learner.begin_epoch("f")
    assert learner.topology is None
    learner.refresh()
    (first,) = learner.updates()
    assert (first.epoch, first.version) == ("f", 1)
    assert first.links == expected()[0][-1].links


def walked(minutes: float, gap: float, lag: float) -> list[Event]:
    """Return people who pass camera a, then b, and others who pass c at the same rate."""
    chance, begin, seconds = np.random.default_rng(4), 3600e3, minutes * 60.0
    events = []
    for k, t in enumerate(begin + chance.uniform(0.0, seconds, int(seconds / gap))):
        later, other = (
            t + 3.0 + lag * chance.lognormal(0.0, 0.1),
            begin + chance.uniform(0.0, seconds),
        )
        for camera, at in (("a", t), ("b", later), ("c", other)):
            events.append(Event(camera, "entry", at, 0.1, 0.5, track=k))
            events.append(Event(camera, "exit", at + 3.0, 0.9, 0.5, track=k))
    return sorted(events, key=lambda event: event.t)


def test_a_guest_that_sends_people_becomes_a_neighbour() -> None:
    sharding = Sharding(districts=3, together=("b", "a", "c"), guest_turns=4, turn_hours=0.5)
    dealing = Assignment(sharding)
    district = District(Settings(refit_share=0.5), "s", "e", dealing, 0)
    (turn_of_a,) = (turn for turn in range(4) if dealing.is_guest("a", turn))
    (turn_of_c,) = (turn for turn in range(4) if dealing.is_guest("c", turn))
    heard: dict[int, set[str]] = {}
    for event in walked(240.0, 20.0, 8.0):
        if district.receive(event) == "accepted":
            turn = district.hearing.turn or 0
            heard.setdefault(turn, set()).add(event.camera)
    district.flush()
    first = min(heard) + (turn_of_a - min(heard)) % 4
    assert first < max(heard) - 1
    assert district.hearing.neighbours == ["a"]
    for turn, cameras in heard.items():
        assert ("a" in cameras) == (turn >= first) or turn in (first - 1, first)
        assert "c" not in cameras or turn % 4 in (
            turn_of_c,
            (turn_of_c - 1) % 4,
            (turn_of_c + 1) % 4,
        )
    before = district.parts()
    assert not [link for link in before[0].topology.links if link.from_.startswith("a/")]
    (found,) = [link for link in before[-1].topology.links if link.from_.startswith("a/")]
    assert found.transit.q50 == pytest.approx(8.0, rel=0.1)
    assert "c" not in district.save().window.cameras or dealing.is_guest("c", max(heard))


def test_what_is_not_heard_changes_nothing() -> None:
    """A district given all events learns the same as with those that it listens to."""
    dealing = Assignment(Sharding(districts=4, guest_turns=4, turn_hours=0.02))
    everything, some = (District(SETTINGS, "s", "e", dealing, 3) for _ in range(2))
    heard = unheard = 0
    for event in site()[0]:
        if some.listens(event.camera, event.t):
            some.receive(event)
            everything.receive(event)
            heard += 1
        else:
            assert everything.receive(event) == "unheard"
            unheard += 1
    some.flush()
    everything.flush()
    assert unheard > 100 < heard
    parts = some.parts()
    assert len(parts) >= 4
    assert everything.parts() == parts


@pytest.mark.parametrize("own", [True, False])
def test_a_camera_that_comes_later_is_found_as_soon(own: bool) -> None:
    """Whether it is the own one or the neighbour, and whichever cameras are guests then."""
    late = "b" if own else "a"
    sharding = Sharding(districts=3, together=("b", "a", "c"), guest_turns=50, turn_hours=0.5)
    district = District(Settings(refit_share=0.5), "s", "e", Assignment(sharding), 0)
    events = [*walked(300.0, 20.0, 8.0)]
    comes = events[0].t + 3 * 3600.0
    for event in events:
        if event.t < comes and event.camera == late:
            continue
        if own and event.t < comes - 600.0 and event.camera == "a":
            event = replace(
                event, camera="e"
            )  # the district knows its cameras, and that it hears nothing of a
        if event.t < comes + 1800.0:
            district.receive(event)
    district.flush()
    links = district.parts()[-1].topology.links
    assert [link for link in links if link.from_.startswith("a/") and link.to.startswith("b/")]


def test_made_up_names_open_no_district() -> None:
    """Except for a few at a time; own cameras are learned as before."""
    sharding = Sharding(districts=3, together=("b", "a", "c"), guest_turns=1000, turn_hours=0.1)
    district = District(SETTINGS, "s", "e", Assignment(sharding), 0)
    events = walked(60.0, 20.0, 8.0)
    for number, event in enumerate(events):
        district.receive(event)
        if event.t > events[0].t + 1800.0:  # the own camera is not new any more
            district.receive(replace(event, camera=f"made-up-{number}", track=None))
    heard = set(district.save().window.cameras)
    known = [name for name in district.hearing.met if name.startswith("made-up")]
    assert len(events) / 2 > 400
    others = [name for name in known if not district.owns(name)]
    assert 0 < len(others) <= NEWCOMERS_MAX < len(known) / 2
    assert "c" in district.strangers()
    assert "c" not in heard
    assert {"a", "b"} <= heard


def test_forgotten_cameras_leave_nothing_behind() -> None:
    events = site()[0][:600]
    gone = {"cam02", "cam05"}
    plain, told = Learner(SETTINGS), Learner(SETTINGS)
    for event in events:
        plain.receive(event)
        if event.camera not in gone:
            told.receive(event)
    plain.forget(gone)
    left, never = plain.save(), told.save()
    assert left.window.cameras == never.window.cameras
    assert left.window.seen == never.window.seen
    assert len(left.cameras) == len(never.cameras)
    for name in ("t", "camera", "entry", "px", "py"):
        assert (left.window.columns[name] == never.window.columns[name]).all(), name
    assert (
        mates(left.window.columns["mate"], left.window.base)
        == mates(never.window.columns["mate"], 0)
    ).all()
    under_way = [(camera, track, row - left.window.base) for camera, track, row in left.window.open]
    assert under_way == never.window.open
    assert sorted(left.intake.cameras) == sorted(never.intake.cameras)
    restored = Learner(SETTINGS)
    restored.load(replace(left, intake=replace(left.intake, held=never.intake.held)))
    for event in site()[0][600:]:
        if event.camera not in gone:
            restored.receive(event)
    restored.flush()
    assert restored.topology is not None
    assert {camera.id for camera in restored.topology.cameras} == {
        e.camera for e in site()[0]
    } - gone


def mates(
    mate: np.ndarray[tuple[int], np.dtype[np.int64]], base: int
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the numbers of rows in the window; -1 for none."""
    return np.where(mate >= base, mate - base, -1)


def test_a_part_that_comes_late_counts_from_then_on() -> None:
    parts = sorted(
        (part for made in expected()[1].values() for part in made),
        key=lambda part: part.topology.as_of,
    )
    late = parts[3]
    line = VersionLine(SETTINGS, "s", "e")
    line.take(parts[:3])
    line.reach(parts[-1].topology.as_of)
    line.updates()
    line.take([late])
    line.reach(parts[-1].topology.as_of)
    (version,) = line.updates()
    assert {camera.id for camera in late.topology.cameras} <= {
        camera.id for camera in version.cameras
    }
    assert line.waiting == 0


def test_a_district_without_cameras_holds_nobody_up() -> None:
    """It receives guests, and possibly nothing more that would advance its time."""
    recorded, truth = site()
    events = recorded[:300]
    late = events[-1].t + 36_000.0
    closing = [replace(events[-1], camera=camera, kind="entry", t=late) for camera in truth.cameras]
    for turns in range(5, 12):
        learner = ShardLearner(
            replace(SETTINGS, lateness_seconds=2000.0), Sharding(districts=64, guest_turns=turns)
        )
        for event in [*events, *closing]:
            learner.receive(event)
        reached = learner.reached()
        assert reached is not None
        assert reached > events[-1].t, turns
