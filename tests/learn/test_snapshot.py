"""A learner that is saved and loaded at any point continues as if uninterrupted."""

from __future__ import annotations

import copy
import random
from collections.abc import Collection
from functools import lru_cache

import msgspec
import pytest

from bench.support.disturbances import (
    Recording,
    with_outages,
    with_turned_cameras,
    with_wrong_clocks,
    without_positions,
    without_tracks,
)
from camtopod.learn.association import screening
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import (
    FORMAT,
    LearnerState,
    NewerSnapshot,
    SnapshotError,
    pack,
    unpack,
)
from camtopod.records import Event
from camtopod.sim.simulation import SimSettings, simulate

SETTINGS = Settings(refit_share=0.4, window_events_max=1200)
LATE = 0.7
"""Share of the events after which the snapshot of most tests is taken."""
NETWORKS = {
    "usual": SimSettings(
        seed=3, cameras=4, hours=0.5, objects_per_second=0.1, labels={"car": 0.7, "bus": 0.2}
    ),
    "hard": SimSettings(seed=4, cameras=4, hours=0.6, objects_per_second=0.12),
    "bare": SimSettings(seed=5, cameras=3, hours=0.4, objects_per_second=0.1),
}


def recorded(name: str) -> Recording:
    """Return the recording of a network; of one a camera is turned, of one only times are left."""
    network = NETWORKS[name]
    recording = simulate(network)
    if name == "hard":
        turned = with_turned_cameras(recording, network, ["cam02"])
        recording = with_outages(turned, network, [("cam03", 0.3, 0.5)])
        return with_wrong_clocks(recording, network)
    if name == "bare":
        return without_tracks(without_positions(recording, network), network)
    return recording


@lru_cache
def events_of(name: str) -> list[Event]:
    """Return events out of order within the lateness, some twice, with boot and seq."""
    events, _ = recorded(name)
    chance = random.Random(1)
    events = sorted(events, key=lambda event: event.t + chance.uniform(0.0, 4.0))
    seqs: dict[str, int] = {}
    numbered = []
    for event in events:
        seq = seqs[event.camera] = seqs.get(event.camera, 0) + 1
        numbered.append(msgspec.structs.replace(event, boot="b", seq=seq))
        if chance.random() < 0.02:
            numbered.append(chance.choice(numbered[-50:]))
    return numbered


def learned(
    learner: Learner,
    events: list[Event],
    points: Collection[int] = (),
    rules: Settings = SETTINGS,
    left_at: int = -1,
    left: list[bytes] | None = None,
) -> list[tuple[int, str]]:
    """Return (version, digest) of all versions, with the learner replaced at each of ``points``.

    At ``left_at`` a snapshot of a copy is appended to ``left``, from which to learn again.
    """
    made = []
    for number, event in enumerate(events):
        if number in points:
            learner = restored(pack(learner.save()), rules=rules)
        if number == left_at and left is not None:
            left.append(pack(copy.deepcopy(learner).save()))
        learner.receive(event)
        made += [(update.version, update.digest) for update in learner.updates()]
    learner.flush()
    return made + [(update.version, update.digest) for update in learner.updates()]


def restored(blob: bytes, spoiled: str = "", rules: Settings = SETTINGS) -> Learner:
    """Return a learner from a snapshot; one part of it may be as in a new learner."""
    state, learner = unpack(blob), Learner(rules, "s", "e")
    if spoiled:
        setattr(state, spoiled, getattr(learner.save(), spoiled))
    learner.load(state)
    return learner


@lru_cache
def at_once(name: str) -> tuple[list[tuple[int, str]], bytes]:
    """Return the versions of an uninterrupted learner, and its snapshot after `LATE` of them."""
    events, left = events_of(name), list[bytes]()
    made = learned(Learner(SETTINGS, "s", "e"), events, left_at=int(LATE * len(events)), left=left)
    return made, left[0]


def expected(name: str) -> list[tuple[int, str]]:
    return at_once(name)[0]


def late(name: str) -> bytes:
    return at_once(name)[1]


@lru_cache
def tail_of(name: str) -> list[tuple[int, str]]:
    """Return the versions of the last events from `late` on."""
    events = events_of(name)
    return learned(restored(late(name)), events[int(LATE * len(events)) :])


@pytest.mark.parametrize("name", NETWORKS)
def test_restored_anywhere_the_versions_are_the_same(name: str) -> None:
    events = events_of(name)
    points = set(random.Random(name).sample(range(len(events)), 5))
    assert len(expected(name)) > 4
    assert learned(Learner(SETTINGS, "s", "e"), events, points) == expected(name)


def test_restored_with_screening_the_versions_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Candidates depend on when each zone was last screened; only a few zones are in each fit."""
    monkeypatch.setattr(screening, "LOOK_SHARE", 0.05)
    monkeypatch.setattr(screening, "SOURCES_MAX", 3)
    monkeypatch.setattr(screening, "UNCONFIRMED_SOURCES_MAX", 2)
    rules = msgspec.structs.replace(SETTINGS, candidates_max=2_000, refit_share=0.3)
    events = events_of("usual")

    def from_half(forgetful: bool = False) -> list[tuple[int, str]]:
        """Take another snapshot after two thirds."""
        with monkeypatch.context() as patch:
            patch.setattr(Learner, "load", forgetting if forgetful else Learner.load)
            return learned(
                restored(left[0], rules=rules), events[half:], {2 * len(events) // 3 - half}, rules
            )

    def forgetting(learner: Learner, state: LearnerState) -> None:
        state.followed = {}
        whole_load(learner, state)

    whole_load, half, left = Learner.load, len(events) // 2, list[bytes]()
    unbroken = learned(Learner(rules, "s", "e"), events, (), rules, half, left)
    made = from_half()
    assert len(unbroken) > 4
    assert len(made) > 1
    assert made == unbroken[-len(made) :]
    assert from_half(forgetful=True) != made


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_a_thousand_restores() -> None:
    for name in NETWORKS:
        for seed in range(17):
            points = set(random.Random(seed).sample(range(len(events_of(name))), 20))
            assert learned(Learner(SETTINGS, "s", "e"), events_of(name), points) == expected(
                name
            ), (name, seed)


@pytest.mark.parametrize("part", ["intake", "window", "scorer", "cameras", "alarms", "since_fit"])
def test_nothing_in_a_snapshot_is_without_effect(part: str) -> None:
    events, name = events_of("hard"), "hard"
    tail = events[int(LATE * len(events)) :]
    whole = tail_of(name)
    assert whole
    assert whole == expected(name)[-len(whole) :]
    try:
        assert learned(restored(late(name), spoiled=part), tail) != whole
    except (IndexError, KeyError, ValueError):
        assert part in ("window", "cameras")  # the rest does not fit any more


def test_every_field_of_the_state_is_saved_by_a_learner_that_has_learned() -> None:
    empty, full = Learner(SETTINGS, "s", "e").save(), unpack(late("hard"))
    same = [
        name
        for name in LearnerState.__struct_fields__
        if _packed(full, name) == _packed(empty, name)
    ]
    # Nothing is followed of so few cameras, none is retired or renamed, and what is
    # moved or doubled is said at once.
    unused = {"followed", "retired", "names", "moved", "doubled"}
    assert set(same) == {"epoch", "settings", "site", *unused}


def _packed(state: LearnerState, name: str) -> bytes:
    others = Learner(SETTINGS, "s", "e").save()
    setattr(others, name, getattr(state, name))
    return pack(others)


def test_a_damaged_snapshot_is_refused() -> None:
    blob = late("usual")
    chance = random.Random(2)
    for cut in [*chance.sample(range(len(blob)), 60), 0, len(blob) - 1]:
        with pytest.raises(SnapshotError):
            unpack(blob[:cut])
    whole = pack(unpack(blob))
    for _ in range(100):
        flipped = bytearray(blob)
        flipped[chance.randrange(len(blob))] ^= 1 << chance.randrange(8)
        try:
            same = pack(unpack(bytes(flipped)))
        except SnapshotError:
            continue
        assert same == whole  # compressed, the same can be said in several ways


@pytest.mark.parametrize(("written", "refusal"), [(-1, SnapshotError), (1, NewerSnapshot)])
def test_a_snapshot_of_another_format_is_refused_by_its_number(
    written: int, refusal: type[SnapshotError], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camtopod.learn.snapshot.FORMAT", FORMAT + written)
    blob = pack(Learner(SETTINGS, "s", "e").save())
    monkeypatch.undo()
    with pytest.raises(SnapshotError, match=f"is {FORMAT + written}, this program's {FORMAT}") as e:
        unpack(blob)
    assert e.type is refusal


def test_a_new_epoch_keeps_what_is_known() -> None:
    events = events_of("usual")
    learner = restored(late("usual"))
    before = learner.topology
    assert before is not None
    learner.begin_epoch("f")
    learner.receive(msgspec.structs.replace(events[-1], t=events[-1].t + 600.0, seq=10**6))
    learner.advance(events[-1].t + 1200.0)
    after = learner.topology
    assert after is not None
    assert (after.epoch, after.version) == ("f", 1)
    assert len(after.links) > 0.8 * len(before.links)  # one that knew nothing would have none


def test_restored_in_a_new_epoch_before_its_first_version_the_versions_are_the_same() -> None:
    """No prediction is made with a version of another epoch, as a snapshot does not have it."""
    tail = events_of("usual")[int(LATE * len(events_of("usual"))) :]
    versions = []
    for points in ((), (0,)):
        learner = restored(late("usual"))
        learner.begin_epoch("f")
        versions.append(learned(learner, tail, points))
    unbroken, broken = versions
    assert broken == unbroken
