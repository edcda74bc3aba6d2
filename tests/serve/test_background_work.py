"""What takes long and nobody waits for is done in little pieces, and what is let go of goes bit by
bit.
"""

from __future__ import annotations

import sys
import threading
import weakref
from collections.abc import Callable

import pytest
from msgspec.structs import replace
from serving import closing_event, numbered, walkers

from camtopod.codec import read_in_parts, to_pack
from camtopod.learn.learner import Learner
from camtopod.predict.predictor import Predictor
from camtopod.records import Event, Prediction, Topology
from camtopod.serve.live_predictions import Live
from camtopod.serve.runtime.background_work import (
    PAUSE_SECONDS_MAX,
    PAUSE_TIMES,
    WORK_SECONDS,
    Leisure,
    let_go,
)

EVENTS = [*numbered(walkers(60)), closing_event()]


def learned() -> Topology:
    learner = Learner(epoch="E")
    for event in EVENTS:
        learner.receive(event)
    assert learner.topology is not None
    return learner.topology


class Calls:
    """How often it was called."""

    def __init__(self) -> None:
        self.number = 0

    def __call__(self) -> None:
        self.number += 1


def test_there_is_a_pause_after_a_little_work_and_longer_than_it() -> None:
    now, rests = [0.0], list[float]()

    def rest(seconds: float) -> None:
        rests.append(seconds)
        now[0] += seconds

    pause = Leisure(rest, lambda: now[0])
    for worked in (0.4, 0.4, 0.4, 0.9, 1000.0):
        now[0] += worked * WORK_SECONDS
        pause()
    assert rests == pytest.approx([PAUSE_TIMES * 1.2 * WORK_SECONDS, PAUSE_SECONDS_MAX])


@pytest.mark.parametrize(
    "make", [Predictor, lambda topology, pause: Predictor(topology).make_ready(bool, pause)]
)
def test_making_a_predictor_gives_way_at_every_zone(
    make: Callable[[Topology, Calls], object],
) -> None:
    topology, pause = learned(), Calls()
    make(topology, pause)
    assert pause.number >= len(topology.zones)


def test_reading_a_topology_gives_way_at_every_part(monkeypatch: pytest.MonkeyPatch) -> None:
    topology, pause = learned(), Calls()
    monkeypatch.setattr("camtopod.codec.PART_BYTES", 100)
    read_in_parts(Topology, to_pack(topology), pause)
    assert pause.number >= len(topology.zones) + len(topology.links)


def test_a_predictor_made_ready_predicts_the_same() -> None:
    topology, made = learned(), []
    for ready in (False, True):
        predictor = Predictor(topology)
        if ready:
            predictor.make_ready(bool)
        made.append([predicted(predictor, event) for event in EVENTS])
    assert made[0] == made[1]


def predicted(predictor: Predictor, event: Event) -> Prediction | None:
    prediction = predictor.predict(event) if event.kind == "exit" else None
    predictor.observe(event)
    return prediction


def test_nothing_is_left_of_what_is_let_go_of_and_what_is_used_stays_whole() -> None:
    topology, pause = learned(), Calls()
    predictor = Predictor(topology)
    packed, gone = to_pack(topology), weakref.ref(predictor._hazards)
    held = sys.getrefcount(topology.links[0])
    wholes: list[object] = [predictor, topology]
    del predictor
    let_go(wholes, pause)
    after = sys.getrefcount(topology.links[0])
    assert (wholes, gone()) == ([], None)
    assert pause.number > len(topology.links)
    assert after == held
    assert to_pack(topology) == packed, "somebody else holds it"


def test_predictions_go_on_while_a_version_is_prepared_and_are_by_the_old_one_until_it_is_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("camtopod.serve.runtime.background_work.WORK_SECONDS", 0.0)
    first = learned()
    second = replace(first, version=first.version + 1)
    made: list[Prediction] = []
    resting, go_on = threading.Event(), threading.Event()

    def rest(seconds: float) -> None:
        resting.set()
        assert go_on.wait(10.0)

    live = Live(made.append, rest=rest)
    live.prepare(first)
    assert not resting.is_set(), "nobody waits for predictions yet"
    live.use(first)
    preparing = threading.Thread(target=live.prepare, args=(second,))
    preparing.start()
    assert resting.wait(10.0)
    exit_ = next(event for event in EVENTS if event.kind == "exit")
    live._step(exit_)
    assert [one.version for one in made] == [first.version]
    go_on.set()
    preparing.join()
    live.use(second)
    live.forget_older()
    assert live._older == []
    live._step(exit_)
    assert [one.version for one in made] == [first.version, second.version]


def test_who_is_in_a_hurry_makes_no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("camtopod.serve.runtime.background_work.WORK_SECONDS", 0.0)
    topology, rests = learned(), list[float]()
    live = Live(lambda _: None, rest=rests.append)
    live.use(topology)
    live.prepare(topology, hurried=True)
    assert rests == []
    live.prepare(topology)
    assert len(rests) > len(topology.zones)
