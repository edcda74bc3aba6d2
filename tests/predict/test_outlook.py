"""One answer of what becomes of an exit: whoever asks, gets the same."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from test_predictor import any_topology

from bench.support.regimes import REGIMES
from camtopod.client import Gate
from camtopod.learn.recording import learn_topology
from camtopod.predict import Departure, Predictor, PreparedVersion, log_density, outlook
from camtopod.records import Topology


def agree(topology: Topology) -> None:
    """Check that `Gate` and a `Predictor` that has observed nothing say the same of each zone."""
    prepared = PreparedVersion(topology)
    gate, predictor = Gate(topology, prepared), Predictor(topology, prepared)
    for zone, record in enumerate(topology.zones):
        prediction = predictor.predict_from(zone, topology.as_of + 10.0)
        assert math.exp(gate.gate_gone(record.id)) == pytest.approx(prediction.leave, abs=1e-6)
        probabilities = [row.probability for row in prediction.next]
        assert prediction.leave + sum(probabilities) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("kind", ["hall", "crowd", "walkway", "road", "short"])
def test_the_gate_and_a_fresh_predictor_agree_on_recordings(kind: str) -> None:
    """Nothing is switched off: overlapping views, paths, doubt, and what may be anywhere."""
    events, _ = REGIMES[kind].make(1, 0.1)
    agree(learn_topology(events[:4000]))


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_the_gate_and_a_fresh_predictor_agree_on_any_model(seed: int) -> None:
    agree(any_topology(np.random.default_rng(seed)))


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_densities_make_the_probability_of_being_seen(seed: int) -> None:
    """The density of all zones over all lags is what `Outlook.unseen` leaves of 1."""
    prepared = PreparedVersion(any_topology(np.random.default_rng(seed)))
    bins = prepared.hazards.bins
    edges, middle = bins.edges, np.clip(bins.centres, bins.lag_min, bins.lag_max)
    for zone in range(len(prepared.zones)):
        answer = outlook(prepared, Departure(zone))
        unseen = answer.unseen(edges)
        at = np.arange(len(prepared.zones))
        density = sum(
            np.exp(log_density(prepared, answer, np.full(len(middle), k), middle)) for k in at
        )
        seen = (density * np.diff(edges)).cumsum()
        # Of the last bin, lags up to the longest one count.
        assert seen[:-1] == pytest.approx(unseen[0] - unseen[1:-1], abs=1e-4)
        assert answer.unlinked >= answer.leave >= 0.0
        assert unseen[-1] == pytest.approx(answer.leave, abs=1e-6)
