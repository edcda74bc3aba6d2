"""What the daemon keeps of a version is a part of it, and says and predicts the same."""

from __future__ import annotations

import sys

import pytest
from msgspec.structs import replace
from serving import closing_event, numbered, walkers

from camtopod.codec import to_pack
from camtopod.learn.learner import Learner
from camtopod.predict.predictor import Predictor
from camtopod.records import Topology
from camtopod.serve.storage.packed_version import Newest, for_prediction, head_of

EVENTS = [*numbered(walkers(60)), closing_event()]


@pytest.fixture
def learned(monkeypatch: pytest.MonkeyPatch) -> Topology:
    monkeypatch.setattr("camtopod.codec.PART_BYTES", 100)  # as if it were large
    learner = Learner(epoch="E")
    for event in EVENTS:
        learner.receive(event)
    assert learner.topology is not None
    return learner.topology


def predicted(topology: Topology) -> list[object]:
    predictor, made = Predictor(topology), list[object]()
    for event in EVENTS:
        if event.kind == "exit":
            made.append(predictor.predict(event))
        predictor.observe(event)
    return made


def test_the_head_of_what_is_packed_is_that_of_the_whole(learned: Topology) -> None:
    head = head_of(to_pack(learned))
    assert head == head_of(learned)
    assert (head.digest, head.zones, head.links) == (
        learned.digest,
        len(learned.zones),
        len(learned.links),
    )
    assert head.zones
    assert head.links


def test_what_is_read_for_predictions_predicts_the_same_and_is_less(learned: Topology) -> None:
    read = for_prediction(to_pack(learned))
    assert predicted(read) == predicted(learned)
    assert learned.links
    assert (read.links, read.weak_links, read.pairs, read.chain) == ([], [], [], [])


def test_links_are_read_for_predictions_where_there_is_no_posterior(learned: Topology) -> None:
    assert learned.model is not None
    for model in (None, replace(learned.model, onward=None)):
        without = replace(learned, model=model)
        assert for_prediction(to_pack(without)).links == learned.links
        assert predicted(for_prediction(to_pack(without))) == predicted(without)


def test_what_is_held_packed_comes_out_as_it_went_in(learned: Topology) -> None:
    packed = to_pack(learned)
    for newest in (Newest(head_of(learned), packed), Newest(head_of(learned), learned)):
        assert newest.topology == learned
        assert to_pack(newest.raw) == packed


def test_a_predictor_holds_no_topology(learned: Topology) -> None:
    assert learned.model is not None
    assert learned.model.contexts
    parts = learned, learned.model, learned.links, learned.model.contexts[0], learned.model.onward
    before = [sys.getrefcount(part) for part in parts]
    predictor = Predictor(learned)
    assert [sys.getrefcount(part) for part in parts] == before
