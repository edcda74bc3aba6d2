"""Outcomes of exits: each prediction is judged within the range of its own version."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from camtopod.learn.outcomes import ScoredPrediction, outcomes_of


def outcomes(reach: float, longest: float, until: float) -> list[Any]:
    """Return the outcome of an exit of a at 1000 s, with an arrival at b after 100 s."""
    candidates = SimpleNamespace(
        departure=np.array([0]), arrival=np.array([0]), pair=np.array([0]), lag=np.array([100.0])
    )
    fit = SimpleNamespace(candidates=candidates, responsibility=np.array([0.75]))
    posterior: Any = SimpleNamespace(fit=fit, doubt=np.zeros(1))
    departures: Any = SimpleNamespace(t=np.array([1000.0]), camera=np.array([0]))
    arrivals: Any = SimpleNamespace(camera=np.array([1]))
    exit_ = ScoredPrediction(1000.0, "a", 1, {"b": 1.0}, {}, reach)
    return outcomes_of(
        [exit_], posterior, departures, arrivals, ["a", "b"], np.zeros(2), longest, until
    )


def test_who_comes_later_than_the_version_looked_for_has_left() -> None:
    assert outcomes(180.0, 180.0, 2000.0) == [{"b": pytest.approx(0.75)}]
    assert outcomes(60.0, 180.0, 2000.0) == [{}], "although the present fit looks further"


@pytest.mark.parametrize(("reach", "longest"), [(600.0, 60.0), (60.0, 600.0)])
def test_an_outcome_waits_for_the_longer_of_the_two_ranges(reach: float, longest: float) -> None:
    assert outcomes(reach, longest, 1599.0) == []
    assert len(outcomes(reach, longest, 1600.0)) == 1


def test_two_exits_of_one_stamp_have_an_outcome_each() -> None:
    """Two leave camera a within a second that its clock does not divide; both are seen at b."""
    candidates = SimpleNamespace(
        departure=np.arange(2), arrival=np.arange(2), pair=np.zeros(2, int), lag=np.full(2, 10.0)
    )
    fit = SimpleNamespace(candidates=candidates, responsibility=np.array([0.9, 0.8]))
    posterior: Any = SimpleNamespace(fit=fit, doubt=np.zeros(1))
    departures: Any = SimpleNamespace(t=np.full(2, 1000.0), camera=np.zeros(2, int))
    arrivals: Any = SimpleNamespace(camera=np.ones(2, int))
    exits = 3 * [ScoredPrediction(1000.0, "a", 1, {"b": 1.0}, {}, 60.0)]

    result = outcomes_of(
        exits, posterior, departures, arrivals, ["a", "b"], np.zeros(2), 60.0, 2000.0
    )

    first, second = {"b": pytest.approx(0.9)}, {"b": pytest.approx(0.8)}
    assert result == [first, second, None], "the third is not among the departures"
