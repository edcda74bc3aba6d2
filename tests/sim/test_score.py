"""Scores of clocks, calibration, time windows and relations against values computed by hand."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from synthetic_events import topology_of

from camtopod.records import Event, NextCamera, Prediction
from camtopod.sim.calibration import calibration_error, calibration_floor
from camtopod.sim.scoring import clock_errors, score_predictions
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import TRUTH_SCHEMA, Truth

TRUTH = simulate(SimSettings(cameras=4, hours=0.3))[1]
PERFECT = topology_of(TRUTH)
replace = msgspec.structs.replace


def test_only_differences_between_clocks_count() -> None:
    true = dict(zip(TRUTH.cameras, (0.0, 2.0, -3.0, 0.5), strict=True))
    learned = dict(zip(TRUTH.cameras, (10.0, 12.0, 7.0, 10.75), strict=True))
    cameras = [replace(camera, clock_offset=learned[camera.id]) for camera in PERFECT.cameras]
    errors = clock_errors(replace(PERFECT, cameras=cameras), replace(TRUTH, clock_offsets=true))
    assert list(errors.values()) == pytest.approx([0.0, 0.0, 0.0, 0.25])
    assert clock_errors(replace(PERFECT, cameras=[]), TRUTH) == {}


def test_calibration_error_by_hand() -> None:
    # Bin 0.6: 0.6 and 0.65 stated, one of two happened: |1.25 - 1|. Bin 1.0 shares the last bin: |1
    # - 0|.
    assert calibration_error([0.6, 0.65, 1.0], [True, False, False]) == pytest.approx(
        (0.25 + 1.0) / 3
    )
    assert calibration_error([0.25] * 4, [True, False, False, False]) == 0
    assert math.isnan(calibration_error([], []))


def two_passages() -> tuple[list[Event], Truth]:
    """Return a person who leaves a at 10 s, appears at b 5 s later, and is not seen again."""
    events = [
        Event("a", "entry", 8.0),
        Event("a", "exit", 10.0),
        Event("b", "entry", 15.0),
        Event("b", "exit", 20.0),
    ]
    truth = Truth(
        TRUTH_SCHEMA, ["a", "b"], [], [], [], {}, [7, 7, 7, 7], [0, 0, 1, 1], [-1, -1, -1, -1]
    )
    return events, truth


def test_windows_are_those_of_the_zone_and_leaving_is_an_outcome() -> None:
    events, truth = two_passages()
    early, late = (
        NextCamera("b", "b/1", 0.5, 1.0, 2.0, 3.0),
        NextCamera("b", "b/2", 0.25, 4.0, 5.0, 6.0),
    )
    first = Prediction("a", "a/1", 10.0, None, 1, 0.25, [early, late])
    second = Prediction(
        "b", "b/1", 20.0, None, 1, 0.75, [NextCamera("a", "a/1", 0.25, 1.0, 2.0, 3.0)]
    )
    by_likeliest = score_predictions([first, second], events, truth)
    assert by_likeliest.window_coverage == 0
    assert (
        score_predictions(
            [first, second], events, truth, zone_of=lambda event: "b/2"
        ).window_coverage
        == 1
    )
    assert (by_likeliest.exits, by_likeliest.followed, by_likeliest.top1) == (2, 1, 1)
    assert by_likeliest.log_loss == pytest.approx(-math.log(0.75))
    # Stated: b 0.75 (came), leave 0.25 (did not); a 0.25 (did not), leave 0.75 (did): each 0.25
    # off, in two bins.
    assert by_likeliest.calibration_error == pytest.approx(0.25)


def test_the_calibration_of_the_first_guess_is_not_diluted_by_the_others() -> None:
    """Both first guesses have probability 0.6 and one comes true: the error is 0.1.

    The mean over all outcomes would be smaller. In the second the first guess is leaving; the two
    zones of a camera count together.
    """
    events, truth = two_passages()
    b = [NextCamera("b", "b/1", 0.3, 1.0, 2.0, 3.0), NextCamera("b", "b/2", 0.3, 4.0, 5.0, 6.0)]
    others = [NextCamera(f"c{k}", f"c{k}/1", 0.01, 1.0, 2.0, 3.0) for k in range(5)]
    first = Prediction("a", "a/1", 10.0, None, 1, 0.35, [*b, *others])
    second = Prediction(
        "b", "b/1", 20.0, None, 1, 0.35, [NextCamera("a", "a/1", 0.6, 1.0, 2.0, 3.0), *others]
    )
    result = score_predictions([first, second], events, truth)
    assert result.first_calibration_error == pytest.approx(0.1)
    assert result.calibration_error < 0.1
    leaving = msgspec.structs.replace(
        second, leave=0.6, next_=[msgspec.structs.replace(b[0], camera="a")]
    )
    assert score_predictions(
        [first, leaving], events, truth
    ).first_calibration_error == pytest.approx(0.4)


def test_the_floor_is_what_right_probabilities_come_to() -> None:
    rng = np.random.default_rng(0)
    stated = rng.uniform(0.2, 1.0, 500)
    errors = [
        calibration_error(stated.tolist(), (rng.random(500) < stated).tolist()) for _ in range(200)
    ]
    assert np.mean(errors) == pytest.approx(calibration_floor(stated.tolist()), rel=0.05)
    assert calibration_floor([1.0, 0.0]) == 0
    assert math.isnan(calibration_floor([]))
