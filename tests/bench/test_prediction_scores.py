"""Scores of predictions and clocks against values computed by hand."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from synthetic_events import topology_of

from bench.support.prediction_scores import (
    calibration_error,
    calibration_floor,
    clock_errors,
    next_entries,
    score_predictions,
)
from camtopod.records import Event, NextCamera, Prediction
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import TRUTH_SCHEMA, Truth

WALK = [
    Event("a", "entry", 8.0),
    Event("a", "exit", 10.0),
    Event("b", "entry", 15.0),
    Event("b", "exit", 20.0),
]
"""A person who leaves a at 10 s, appears at b 5 s later, and is not seen again."""
TOLD = Truth(TRUTH_SCHEMA, ["a", "b"], [], [], [], {}, [7] * 4, [0, 0, 1, 1], [-1] * 4)
TO_A = NextCamera("a", "a/1", 0.25, 1.0, 2.0, 3.0)
replace = msgspec.structs.replace


def test_only_differences_between_clocks_count() -> None:
    _, truth = simulate(SimSettings(cameras=4, hours=0.1))
    topology = topology_of(truth)
    true = dict(zip(truth.cameras, (0.0, 2.0, -3.0, 0.5), strict=True))
    learned = dict(zip(truth.cameras, (10.0, 12.0, 7.0, 10.75), strict=True))
    cameras = [replace(camera, clock_offset=learned[camera.id]) for camera in topology.cameras]

    errors = clock_errors(replace(topology, cameras=cameras), replace(truth, clock_offsets=true))

    assert list(errors.values()) == pytest.approx([0.0, 0.0, 0.0, 0.25])


def test_calibration_error_by_hand() -> None:
    # Bin 0.6: 0.6 and 0.65 stated, one of two happened: |1.25 - 1|. Bin 1.0 shares the last bin.
    some = calibration_error([0.6, 0.65, 1.0], [True, False, False])

    assert some == pytest.approx((0.25 + 1.0) / 3)
    assert calibration_error([0.25] * 4, [True, False, False, False]) == 0
    assert math.isnan(calibration_error([], []))


def test_the_floor_is_what_right_probabilities_come_to() -> None:
    rng = np.random.default_rng(0)
    stated = rng.uniform(0.2, 1.0, 500)
    errors = [
        calibration_error(stated.tolist(), (rng.random(500) < stated).tolist()) for _ in range(200)
    ]

    assert np.mean(errors) == pytest.approx(calibration_floor(stated.tolist()), rel=0.05)
    assert math.isnan(calibration_floor([]))


def test_windows_are_those_of_the_zone_and_leaving_is_an_outcome() -> None:
    early = NextCamera("b", "b/1", 0.5, 1.0, 2.0, 3.0)
    late = NextCamera("b", "b/2", 0.25, 4.0, 5.0, 6.0)
    made = [
        Prediction("a", "a/1", 10.0, None, 1, 0.25, [early, late]),
        Prediction("b", "b/1", 20.0, None, 1, 0.75, [TO_A]),
    ]

    result = score_predictions(made, WALK, TOLD)
    by_zone = score_predictions(made, WALK, TOLD, zone_of=lambda event: "b/2")

    assert (result.exits, result.followed, result.top1) == (2, 1, 1)
    assert (result.window_coverage, by_zone.window_coverage) == (0, 1)
    assert result.log_loss == pytest.approx(-math.log(0.75))
    # b 0.75 (came), leave 0.25 (did not); a 0.25 (did not), leave 0.75 (did): 0.25 off each.
    assert result.calibration_error == pytest.approx(0.25)


def test_without_anybody_to_follow_no_guess_is_right() -> None:
    prediction = Prediction("b", "b/1", 20.0, None, 1, 0.75, [TO_A])
    truth = replace(TOLD, identity=[7] * 2, passage=[1] * 2, zone=[-1] * 2)
    result = score_predictions([prediction], WALK[2:], truth)
    assert (result.exits, result.followed) == (1, 0)
    assert math.isnan(result.top1)
    assert math.isnan(result.top3)


def test_the_calibration_of_the_first_guess_is_not_diluted_by_the_others() -> None:
    """Both first guesses have probability 0.6, a camera's zones together, and one comes true."""
    b = [NextCamera("b", f"b/{k}", 0.3, 1.0, 2.0, 3.0) for k in (1, 2)]
    others = [NextCamera(f"c{k}", f"c{k}/1", 0.01, 1.0, 2.0, 3.0) for k in range(5)]
    made = [
        Prediction("a", "a/1", 10.0, None, 1, 0.35, [*b, *others]),
        Prediction("b", "b/1", 20.0, None, 1, 0.35, [replace(TO_A, probability=0.6), *others]),
    ]

    result = score_predictions(made, WALK, TOLD)

    assert result.first_calibration_error == pytest.approx(0.1)
    assert result.calibration_error < 0.1


def test_the_next_entry_is_that_of_the_next_recorded_passage() -> None:
    events, truth = simulate(SimSettings(cameras=6, hours=0.2))

    following = next_entries(events, truth)

    for index, entry in enumerate(following):
        later = [
            (truth.passage[k], k)
            for k, event in enumerate(events)
            if (truth.identity[k], event.kind) == (truth.identity[index], "entry")
            and truth.passage[k] > truth.passage[index]
        ]
        if events[index].kind == "entry" or truth.identity[index] < 0:
            later = []
        assert entry == min(later, default=(0, -1))[1]


def test_predictions_for_other_events_are_refused() -> None:
    made = [Prediction(e.camera, None, e.t, None, 1, 1.0, []) for e in (WALK[1], WALK[3])]

    with pytest.raises(ValueError, match="is not for exit line"):
        score_predictions(made[::-1], WALK, TOLD)
    with pytest.raises(ValueError, match="shorter"):
        score_predictions(made[:-1], WALK, TOLD)
