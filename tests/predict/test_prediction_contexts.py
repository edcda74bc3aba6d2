"""What contexts tell about the next camera: where an object was before says which way it goes."""

from __future__ import annotations

import numpy as np

from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event, Prediction


def road(seed: int, vehicles: int) -> list[Event]:
    """Return five cameras in a row without positions; half of the vehicles go each way."""
    rng = np.random.default_rng(seed)
    events = []
    for k, t in enumerate(rng.uniform(0, 60.0 * vehicles, vehicles)):
        for camera in "abcde" if k % 2 else "edcba":
            stay = rng.uniform(2, 4)
            events.append(Event(camera, "entry", t, track=str(k)))
            events.append(Event(camera, "exit", t + stay, track=str(k)))
            t += stay + rng.uniform(8, 14)
    return sorted(events, key=lambda event: event.t)


def asked(events: list[Event]) -> list[tuple[Event, Prediction]]:
    """Learn two thirds of the events and predict the exits after them."""
    cut = 2 * len(events) // 3
    learner = Learner(Settings(version_seconds=1e6))
    for event in events[:cut]:
        learner.receive(event)
    learner.flush()
    predictor, answers = learner.predictor(), []
    for k, event in enumerate(events):
        if event.kind == "exit" and k >= cut:
            answers.append((event, predictor.predict(event)))
        predictor.observe(event)
    return answers


def right(answers: list[tuple[Event, Prediction]], goes_to: dict[tuple[str, str], str]) -> float:
    """Return the top-1 of the predictions for objects that go on (by camera and track)."""
    known = [
        (p, goes_to[e.camera, str(e.track)])
        for e, p in answers
        if (e.camera, str(e.track)) in goes_to
    ]
    return float(np.mean([bool(p.next) and p.next[0].camera == camera for p, camera in known]))


def test_on_a_road_the_camera_before_says_which_way() -> None:
    """From the present camera alone, one prediction in two is right."""
    events = road(0, 300)
    goes_to = {
        (camera, str(k)): following
        for k in range(300)
        for camera, following in (
            zip("bcd", "cde", strict=True) if k % 2 else zip("dcb", "cba", strict=True)
        )
    }
    answers = asked(events)

    assert right(answers, goes_to) > 0.93
    forgetful = [Event(e.camera, e.kind, e.t) for e in events]  # no tracks: no direction
    by_time = {
        (e.camera, str(e.t)): goes_to[e.camera, str(e.track)]
        for e in events
        if (e.camera, str(e.track)) in goes_to
    }
    blind = [(Event(e.camera, e.kind, e.t, track=str(e.t)), p) for e, p in asked(forgetful)]
    assert 0.3 < right(blind, by_time) < 0.7
