"""The packed version that the daemon keeps is smaller, but predicts and publishes the same."""

from __future__ import annotations

import sys

import pytest
from serving import closing_event, numbered, walkers

from camtopod.codec import to_msgpack
from camtopod.learn.learner import Learner
from camtopod.predict.predictor import Predictor
from camtopod.records import Topology
from camtopod.serve.storage.packed_version import CurrentVersion, head_of
from camtopod.topology import links_between_views

EVENTS = [*numbered(walkers(60)), closing_event()]


@pytest.fixture(scope="module")
def learned() -> Topology:
    learner = Learner(epoch="E")
    for event in EVENTS:
        learner.receive(event)
    assert learner.topology is not None
    return learner.topology


def test_the_head_of_what_is_packed_is_that_of_the_whole(learned: Topology) -> None:
    head = head_of(to_msgpack(learned))
    assert head == head_of(learned)
    assert (head.digest, head.zones, head.links) == (
        learned.digest,
        len(learned.zones),
        len(links_between_views(learned)),
    )
    assert head.zones
    assert 0 < head.links < len(learned.links)


def test_what_is_held_packed_comes_out_as_it_went_in(learned: Topology) -> None:
    packed = to_msgpack(learned)
    for newest in (
        CurrentVersion(head_of(learned), packed),
        CurrentVersion(head_of(learned), learned),
    ):
        assert newest.topology == learned
        assert to_msgpack(newest.raw) == packed


def test_a_predictor_holds_no_topology(learned: Topology) -> None:
    assert learned.model is not None
    assert learned.model.contexts
    parts = learned, learned.model, learned.links, learned.model.contexts[0], learned.model.onward
    before = [sys.getrefcount(part) for part in parts]
    predictor = Predictor(learned)
    assert [sys.getrefcount(part) for part in parts] == before
    del predictor
