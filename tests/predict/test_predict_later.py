"""Predictions asked for after the exit, when some entries have come and others have not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from model_rows import Pace, Way, with_rows
from msgspec.structs import replace
from test_predictor import (
    ENTERED,
    EXIT,
    OVERLAP,
    THERE,
    THREE,
    a_made_up_network,
    a_topology,
    chances,
    link,
    sound,
    uncounted,
)

from bench.support.prediction_scores import PredictionScore, score_predictions
from camtopod.predict import anywhere
from camtopod.predict.predictor import Predictor
from camtopod.records import (
    Event,
    Prediction,
    Topology,
)

AT_B = Event("b", "entry", 1008.0, 0.5, 0.5)


@pytest.fixture(autouse=True)
def _everything_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nothing be anywhere; that is tested in test_anywhere."""
    monkeypatch.setattr(anywhere, "surplus", lambda departures, leave, cameras: 0.0)


def later(seconds: float, events: list[Event], topology: Topology = THREE) -> Prediction:
    """Predict so long after the exit, with all of these events observed."""
    predictor = Predictor(topology)
    for event in events:
        predictor.observe(event)
    prediction = predictor.predict(EXIT, EXIT.t + seconds)
    sound(prediction)
    return prediction


@pytest.mark.parametrize("is_heard_first", [True, False])
def test_an_arrival_before_the_entry_is_of_another_object(is_heard_first: bool) -> None:
    """Even if it is reported after the exit, as the clock of its camera is fast."""
    cameras = [replace(c, clock_offset=5.0 if c.id == "d" else 0.0) for c in OVERLAP.cameras]
    topology = replace(OVERLAP, cameras=cameras)

    def answer(entry_t: float, kind: str = "entry") -> Prediction:
        other = replace(THERE, kind=kind, t=1000.5)  # 995.5 by the clock of camera a
        order = [other, EXIT] if is_heard_first else [EXIT, other]
        return later(2.0, [replace(ENTERED, t=entry_t), *order], topology)

    assert answer(995.6) == answer(995.6, "exit")
    assert chances(answer(995.4))["d/1"] > 0.9 > chances(answer(995.6))["d/1"]


def test_who_has_not_come_is_elsewhere_or_gone() -> None:
    """From a/1: 0.5 to b in 8 s, 0.3 to c in 20 s, 0.1 to a/2 in 30 s, 0.1 leave the site."""
    none_at_b = later(14.0, [])

    assert chances(none_at_b).get("b/1", 0.0) < 0.01
    assert chances(none_at_b)["c/1"] == pytest.approx(0.6, abs=0.02)
    assert chances(none_at_b)["a/2"] == pytest.approx(0.2, abs=0.02)
    assert none_at_b.leave == pytest.approx(0.2, abs=0.02)
    assert later(25.0, []).leave == pytest.approx(0.5, abs=0.05)
    assert later(60.0, []).leave > 0.97
    leaves = [later(seconds, []).leave for seconds in np.arange(0.0, 60.0, 0.7)]
    assert leaves == sorted(leaves)


def test_who_came_when_due_was_it() -> None:
    came = later(14.0, [AT_B])

    assert chances(came)["b/1"] > 0.98
    assert 7.0 < came.next[0].q10 <= 8.0 <= came.next[0].q90 < 9.0
    assert chances(later(14.0, [replace(AT_B, t=1002.0)])).get("b/1", 0.0) < 0.01, (
        "too early for it"
    )
    back = Event("a", "entry", 1030.0, 0.9, 0.5, "5")
    assert chances(later(40.0, [back]))["a/2"] > 0.97, "at the same camera"
    twice = chances(later(25.0, [AT_B, replace(AT_B, camera="c", t=1020.0)]))
    assert twice["b/1"] + twice["c/1"] > 0.98
    assert min(twice["b/1"], twice["c/1"]) > 0.1, "it may have been either"


@pytest.mark.parametrize("topology", [THREE, OVERLAP])
def test_at_the_exit_the_answer_is_that_of_the_exit(topology: Topology) -> None:
    predictor = Predictor(topology)
    for event in (ENTERED, THERE):
        predictor.observe(event)
    at_exit = predictor.predict(EXIT)

    assert predictor.predict(EXIT, EXIT.t) == at_exit
    predictor.observe(EXIT)
    again = predictor.predict(EXIT, EXIT.t)
    assert chances(again) == pytest.approx(chances(at_exit), abs=1e-3)
    assert [(n.q10, n.q50, n.q90) for n in again.next] == [
        (n.q10, n.q50, n.q90) for n in at_exit.next
    ]


def test_clocks_are_taken_as_they_are() -> None:
    """The clock of b is 5 s ahead: arrivals there after 8 s are not received before 13 s."""
    ahead = replace(
        THREE, cameras=[replace(c, clock_offset=5.0 * (c.id == "b")) for c in THREE.cameras]
    )

    assert chances(later(11.0, [], THREE)).get("b/1", 0.0) < 0.05
    waiting = later(11.0, [], ahead)
    assert chances(waiting)["b/1"] > 0.45
    assert 11.0 <= waiting.next[0].q10 <= waiting.next[0].q50 == pytest.approx(13.0, abs=1.0)
    assert chances(later(19.0, [], ahead)).get("b/1", 0.0) < 0.01
    came = replace(AT_B, t=1013.0)
    assert chances(later(12.9, [came], ahead)) == pytest.approx(
        chances(later(12.9, [], ahead)), abs=1e-3
    )
    assert chances(later(13.1, [came], ahead))["b/1"] > 0.98


def test_who_was_slow_is_awaited_for_longer() -> None:
    """The dwell time is three times the usual one, and so is the transit time: 24 s
    instead of 8 s.
    """
    pace = Pace(1.0, 1.0, 0.3, [Way("a/2", "a/1", 10.0)])
    walk = with_rows(a_topology([link("a/1", "b/1", 0.8, 8.0)]), pace=pace)
    entered = replace(ENTERED, x=0.9, y=0.5)
    usual, slow = [entered], [replace(entered, t=970.0)]

    assert chances(later(15.0, usual, walk)).get("b/1", 0.0) < 0.02
    assert chances(later(15.0, slow, walk))["b/1"] == pytest.approx(0.8, abs=0.02)
    assert 20.0 < later(15.0, slow, walk).next[0].q50 < 28.0
    assert chances(later(40.0, slow, walk)).get("b/1", 0.0) < 0.02
    at_24 = later(30.0, [*slow, replace(AT_B, t=1024.0)], walk)
    assert chances(at_24)["b/1"] > 0.98
    assert at_24.next[0].q10 <= 24.0 <= at_24.next[0].q90 < 27.0
    assert chances(later(30.0, [*usual, replace(AT_B, t=1024.0)], walk)).get("b/1", 0.0) < 0.2


@pytest.mark.parametrize("now", [999.9, math.nan, math.inf])
def test_nobody_is_asked_about_before_leaving(now: float) -> None:
    predictor = Predictor(THREE)
    for event in (EXIT, replace(EXIT, camera="unknown"), replace(EXIT, camera="d", x=0.5)):
        with pytest.raises(
            ValueError, match=r"now is .*: give the time of the exit, 1000\.0, or a later one"
        ):
            predictor.answer(event, now)
    with pytest.raises(ValueError, match="now is"):
        predictor.predict_from(0, 1000.0, now=now)


def test_on_a_made_up_network_more_is_known_later() -> None:
    events, truth, cut, learner = a_made_up_network()

    def scored(seconds: float) -> PredictionScore:
        predictor, said, waiting = learner.predictor(), [], []
        for k, event in enumerate(events):
            while waiting and waiting[0].t + seconds < event.t:
                said.append(predictor.predict(waiting[0], waiting[0].t + seconds))
                del waiting[0]
            predictor.observe(event)
            if event.kind == "exit" and k < cut:
                said.append(uncounted(event))
            elif event.kind == "exit":
                waiting.append(event)
        said += [predictor.predict(event, event.t + seconds) for event in waiting]
        return score_predictions(said, events, truth, since=events[cut].t)

    first, second, third = scored(0.0), scored(15.0), scored(45.0)
    assert first.log_loss > second.log_loss + 0.05 > third.log_loss + 0.05
    assert first.top1 + 0.015 < third.top1
