"""Links between views, their transit times and shares, on six cameras of each kind.

Bounds are those of the learner as it is, with room for a change that is no worse: they are there to
notice a step that was replaced by something worse. The bench measures how good it is.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace
from support.judged_sites import JudgedSite, judged
from support.synthetic_events import learned_from, passage

from bench.support.disturbances import without_positions
from camtopod.records import Event
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

SEED = 11
WALKED = 10
"""Transitions from which a way counts as walked."""


class Kind(NamedTuple):
    """A kind of site, and what is asked of it.

    settings: its simulation.
    found: least share of the walked ways that are links.
    mode, median, tails: largest median error of the mode, the median, and the 10 % and 90 %
        quantiles of the transit times, seconds.
    share: largest mean error of the links' shares.
    placed: False without positions.
    """

    settings: SimSettings
    found: float
    mode: float
    median: float
    tails: float
    share: float
    placed: bool = True


USUAL = SimSettings(cameras=6, hours=0.7, seed=SEED)
SPARSE = replace(USUAL, hours=6.0, objects_per_second=0.03)
DENSE = replace(USUAL, hours=0.15, objects_per_second=1.0)
MISSED = replace(USUAL, hours=1.5, missed=0.2)
NO_POSITIONS = replace(USUAL, hours=2.0, objects_per_second=0.05)
KINDS = {
    "usual": Kind(USUAL, 0.78, 1.0, 0.3, 1.5, 0.05),
    "sparse": Kind(SPARSE, 0.9, 1.5, 0.3, 0.6, 0.025),
    "dense": Kind(DENSE, 0.4, 1.0, 0.4, 1.0, 0.06),
    "two speeds": Kind(replace(USUAL, slow_share=0.3), 0.78, 3.0, 0.5, 1.5, 0.05),
    "overlapping views": Kind(replace(USUAL, overlap_share=0.8), 0.85, 1.0, 0.3, 0.5, 0.05),
    "clutter": Kind(replace(USUAL, hours=1.0, clutter=0.3), 0.85, 2.0, 0.4, 1.0, 0.05),
    "missed passages": Kind(MISSED, 0.85, 1.5, 0.4, 1.2, 0.05),
    "no positions": Kind(NO_POSITIONS, 0.55, 2.0, 1.0, 6.0, 0.06, placed=False),
}


@cache
def site(name: str) -> JudgedSite:
    """Return what is learned of a site of a kind, beside the truth."""
    kind = KINDS[name]
    events, truth = simulate(kind.settings)
    if not kind.placed:
        events, truth = without_positions((events, truth), kind.settings)
    return judged(learned_from(events), events, truth)


@pytest.mark.parametrize("name", KINDS)
def test_walked_ways_are_links_and_nothing_else_is(name: str) -> None:
    assert site(name).false == []
    assert site(name).found(WALKED) >= KINDS[name].found


@pytest.mark.parametrize("name", KINDS)
def test_transit_times_are_those_of_the_walkers(name: str) -> None:
    kind, one = KINDS[name], site(name)

    assert one.transit_error("mode", 0.5) <= kind.mode
    assert one.transit_error("q50", 0.5) <= kind.median
    assert one.transit_error("q10", 0.1) <= kind.tails
    assert one.transit_error("q90", 0.9) <= kind.tails


@pytest.mark.parametrize("name", KINDS)
def test_shares_are_those_of_the_walkers(name: str) -> None:
    assert site(name).share_error() <= KINDS[name].share


def test_what_a_busy_hour_tells_is_told_a_quiet_day_later() -> None:
    """An occasion is a part of the events: all of a day's may be those of one hour."""
    chance, events = np.random.default_rng(SEED), list[Event]()
    times = [*chance.uniform(0.0, 3600.0, 10), 86_400.0, 90_000.0]
    for walk, t in enumerate(times):
        events += passage("a", t, 4.0, f"{walk}")
        events += passage("b", t + 14.0 + chance.normal(0.0, 1.0), 4.0, f"{walk}")
    topology = learned_from(sorted(events, key=lambda event: event.t))
    [link] = [link for link in topology.links if link.relation != "visible"]
    assert (link.from_, link.to) == ("a/1", "b/1")
    assert link.q_value < 1e-20, "1e-11 where the busy hour is one occasion"
