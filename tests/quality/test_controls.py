"""Recordings of cameras that nothing joins: no link is learned.

Each control and seed is one on which a learner with a worse step finds links, or another kind of
traffic. `python -m bench controls` measures many more, and how often there is a false link.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from support.synthetic_events import learned_from, passage

from bench.controls import Outcome, judge
from bench.support.control_recordings import BEGINNING, Street, Traffic, TwoSites
from camtopod.records import Event

SEED = 11
NOTHING_JOINED = {
    "few passages": (Traffic(8, 2.0, 10.0), SEED),
    "many passages in ten minutes": (Traffic(4, 40.0, 10.0, 3.0, 1.0), 12),
    "doors": (Traffic(4, 20.0, 10.0, doors=3), SEED),
    "long stays": (Traffic(4, 10.0, 15.0, 60.0, 40.0), SEED),
    "groups": (Traffic(4, 10.0, 20.0, rhythm="groups"), SEED),
    "bells": (Traffic(4, 10.0, 30.0, rhythm="bells", cycle=30.0), 2),
    "batches": (Traffic(4, 6.0, 60.0, rhythm="batches", cycle=300.0), 0),
    "batches, and doors": (Traffic(4, 6.0, 60.0, rhythm="batches", cycle=300.0, doors=3), 0),
    "a rhythm in common": (Traffic(4, 4.0, 120.0, rhythm="day"), 2),
    "another rhythm in common": (Traffic(4, 4.0, 120.0, rhythm="day"), SEED),
    "a rhythm in common, and doors": (Traffic(4, 4.0, 120.0, rhythm="day", doors=3), SEED),
}
"""Controls, and the seed of the recording of each."""


def outcome(events: Sequence[Event]) -> Outcome:
    """Return what is learned of a recording of cameras that nothing joins."""
    return judge(learned_from([*events]), {}, len(events))


@pytest.mark.parametrize("name", NOTHING_JOINED)
def test_no_link_joins_cameras_that_nothing_joins(name: str) -> None:
    traffic, seed = NOTHING_JOINED[name]

    assert outcome(traffic.record(seed)).false == []


def test_a_group_that_walks_past_two_cameras_once_is_no_link() -> None:
    traffic, chance = Traffic(4, 2.0, 60.0), np.random.default_rng(2)
    events = traffic.record(2)
    for person in range(10):
        t = BEGINNING + 1800.0 + person + chance.uniform()
        for camera in ("c1", "c2"):
            events += passage(camera, t, traffic.stay, f"{camera}, {person}")
            t += traffic.stay + 10.0 + chance.normal(0.0, 0.5)

    assert outcome(sorted(events, key=lambda event: event.t)).false == []


def test_a_street_with_lights_that_drift_has_its_ways_only() -> None:
    street = Street("drift")
    events = street.record(102)

    learned = judge(learned_from(events), street.ways, len(events))

    assert learned.false == []
    assert learned.right == len(street.ways)


def test_two_sites_have_their_own_ways_and_none_between_them() -> None:
    sites = TwoSites()
    events = sites.record(SEED)

    learned = judge(learned_from(events), sites.ways, len(events))

    assert learned.false == []
    assert learned.right >= len(sites.ways) - 1
