"""What fits hand on: by place, not by index; going on ends where starting from nothing does, nearly."""

from __future__ import annotations

import numpy as np
import pytest
from made import Views

from camtopod.learn.candidates import Arrivals, Candidates, Departures, find_candidates
from camtopod.learn.joint import Fit, fit_jointly
from camtopod.learn.lags import LagBins
from camtopod.learn.memory import FRESH_SHARE, Memory
from camtopod.learn.scene import Passages, Scene, ZoneRef
from camtopod.learn.slowness import NO_PERSISTENCE

BINS = LagBins(-60.0, 120.0)
ZONES = [ZoneRef(0, 1, None), ZoneRef(1, 1, None), ZoneRef(1, 2, None)]

Problem = tuple[Departures, Arrivals, Candidates, LagBins, int, float]


def recording(seed: int, objects: int) -> Problem:
    """From zone 0 to zone 1: half of them 3 s after they came, the others 10 s after they left; zone 2 is apart."""
    rng = np.random.default_rng(seed)
    views = Views([0, 1, 1])
    for t in rng.uniform(0, 20.0 * objects, objects):
        left = t + rng.uniform(6, 40)
        views.through(t, left, 0, 0)
        came = t + rng.normal(3, 0.3) if rng.random() < 0.5 else left + rng.normal(10, 0.5)
        views.through(came, came + 1.0, 1, 1)
    for t in rng.uniform(0, 20.0 * objects, objects // 3):
        views.through(t, t + 1.0, 2, 2)
    departures, arrivals = views.columns()
    until = float(max(departures.t[-1], arrivals.t[-1]))
    return departures, arrivals, find_candidates(departures, arrivals, BINS, 3), BINS, 3, until


def scene_of(asked: Problem, zones: list[ZoneRef]) -> Scene:
    none = np.zeros(0, np.int32)
    passages = Passages(none, none, none.astype(float), none.astype(float))
    count = np.zeros(len(zones), np.int64)
    return Scene(zones, asked[0], asked[1], passages, count, count, np.zeros(2, bool), 0.0, asked[-1])


def learned(asked: Problem) -> tuple[Memory, Fit]:
    memory, linked = Memory(), fit_jointly(*asked)
    memory.remember(linked, scene_of(asked, ZONES))
    return memory, linked


def table(source: np.ndarray, target: np.ndarray, rows: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    return {(int(u), int(v)): row for u, v, row in zip(source, target, rows, strict=True)}


def test_a_fit_from_nothing_is_due_when_half_the_window_is_new() -> None:
    memory = Memory()
    assert memory.fresh_due(0, 100)
    memory.started(1000)
    due = int(1000 + FRESH_SHARE * 400)
    assert not memory.fresh_due(due - 1, 400)
    assert memory.fresh_due(due, 400)


def test_nothing_remembered() -> None:
    asked = recording(0, 40)
    known = Memory().links(asked[2], scene_of(asked, ZONES), BINS)
    assert not known.hazard.any()
    assert known.persistence == NO_PERSISTENCE


@pytest.mark.parametrize("renumbered", [False, True])
def test_what_is_known_is_by_place_not_by_index(renumbered: bool) -> None:
    """In the next version the zones may stand in another order, one be gone and another new."""
    asked = recording(1, 80)
    memory, linked = learned(asked)
    c = asked[2]
    zones = [ZoneRef(1, 1, None), ZoneRef(0, 1, None), ZoneRef(1, 7, None)] if renumbered else ZONES
    was = {0: 1, 1: 0} if renumbered else {0: 0, 1: 1, 2: 2}
    scene, none = scene_of(asked, zones), np.zeros(BINS.size)

    def expected(of: dict[tuple[int, int], np.ndarray], u: int, v: int) -> np.ndarray:
        return of.get((was[u], was[v]), none) if {u, v} <= was.keys() else none

    of_links = table(linked.candidates.source, linked.candidates.target, linked.hazard)
    known = memory.links(c, scene, BINS)
    assert known.persistence == linked.persistence
    for k, (u, v) in enumerate(zip(c.source.tolist(), c.target.tolist(), strict=True)):
        assert (known.hazard[k] == expected(of_links, u, v)).all()
    assert known.hazard.any()


def shares(found: Fit, departures: Departures) -> np.ndarray:
    result = np.zeros((3, 3))
    result[found.candidates.source, found.candidates.target] = found.counts.sum(axis=1)
    return result / np.bincount(departures.zone, minlength=3)[:, None]


def test_going_on_gives_nearly_the_same_as_starting_from_nothing() -> None:
    """Over the same events again and again, and over events that came since."""
    asked = recording(2, 600)
    memory, linked = learned(asked)
    again = linked
    for _ in range(5):
        again = fit_jointly(*asked, memory.links(asked[2], scene_of(asked, ZONES), BINS))
        memory.remember(again, scene_of(asked, ZONES))
    assert shares(again, asked[0]) == pytest.approx(shares(linked, asked[0]), abs=0.03)
    more = recording(3, 630)
    fresh = fit_jointly(*more)
    onward = fit_jointly(*more, memory.links(more[2], scene_of(more, ZONES), BINS))
    assert shares(onward, more[0])[0, 1] == pytest.approx(shares(fresh, more[0])[0, 1], abs=0.03)
    assert shares(fresh, more[0])[0, 1] > 0.9
