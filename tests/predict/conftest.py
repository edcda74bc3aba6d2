"""Fixtures of the tests of predictions and walks."""

from __future__ import annotations

import pytest
from serving import closing_event, walkers

from camtopod.learn.learner import Learner
from camtopod.records import Topology


@pytest.fixture(scope="session")
def learned() -> Topology:
    """Objects cross the view of a, and nine seconds later that of b or c."""
    learner = Learner(epoch="E")
    for event in [*walkers(400), closing_event()]:
        learner.receive(event)
    assert learner.topology is not None
    return learner.topology
