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
from camtopod.words import sum_by_camera


def agree(topology: Topology) -> None:
    """Check that `Gate` and a `Predictor` that has observed nothing say the same of each zone."""
    prepared = PreparedVersion(topology)
    gate, predictor = Gate(topology, prepared), Predictor(topology, prepared)
    for zone, record in enumerate(topology.zones):
        prediction = predictor.predict_from(zone, topology.as_of + 10.0)
        assert math.exp(gate.gate_gone(record.id)) == pytest.approx(prediction.leave, abs=1e-6)
        probabilities = [row.probability for row in prediction.next]
        assert prediction.leave + sum(probabilities) == pytest.approx(1.0, abs=1e-6)


def sums(topology: Topology) -> None:
    """Check the integrals of `Gate.gate` from the busiest zone against the `Predictor`."""
    prepared = PreparedVersion(topology)
    gate, predictor = Gate(topology, prepared), Predictor(topology, prepared)
    exits = [zone.exits for zone in topology.zones]
    for zone in np.argsort(exits)[-1:].tolist():
        record, answer = topology.zones[zone], outlook(prepared, Departure(zone))
        delays = [0.0] if answer.table is None else np.unique(answer.table.outcomes.delay)
        edges = np.unique([prepared.hazards.bins.edges + delay for delay in delays])
        edges = np.unique(np.append(edges, [0.0, prepared.longest_lag]))
        lags = list(zip(edges[:-1].tolist(), np.diff(edges).tolist(), strict=True))
        prediction = predictor.predict_from(zone, topology.as_of + 10.0)
        expected = sum_by_camera(prediction.next)
        left_t = prepared.clock_offset[record.camera]
        total = math.exp(gate.gate_gone(record.id))
        for camera, ahead in prepared.clock_offset.items():
            integral = sum(
                math.exp(gate.gate(record.id, left_t, camera, lag + width / 2 + ahead)) * width
                for lag, width in lags
            )
            assert integral == pytest.approx(expected.get(camera, 0.0), abs=1e-3)
            total += integral
        assert total == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("kind", ["hall", "crowd", "walkway", "road", "short"])
def test_the_gate_and_a_fresh_predictor_agree_on_recordings(kind: str) -> None:
    """Nothing is switched off: overlapping views, paths, doubt, and what may be anywhere."""
    events, _ = REGIMES[kind].make(1, 0.1)
    topology = learn_topology(events[:4000])
    agree(topology)
    sums(topology)


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
