"""Whatever the learner writes, a predictor reads."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from model_rows import rows_of

from camtopod.codec import decode_topology, to_json
from camtopod.learn.learner import Learner
from camtopod.predict import Predictor
from camtopod.records import Event


def any_events(rng: np.random.Generator) -> list[Event]:
    """Return the events of a small made-up site, with or without positions, tracks and overlap."""
    cameras = int(rng.integers(2, 6))
    lag = rng.normal(rng.choice([0.0, 6.0]), rng.choice([1.0, 30.0]), (cameras, cameras))
    onward = rng.dirichlet(np.full(cameras, 0.3), cameras)
    has_positions, has_tracks = rng.random(2) < 0.7
    events = []
    for k in range(int(rng.integers(10, 80))):
        t = rng.uniform(0.0, float(rng.choice([60.0, 3000.0])))
        camera = int(rng.integers(cameras))
        for leg in range(int(rng.integers(1, 5))):
            track = f"{k}.{leg}" if has_tracks else None
            dwell = rng.exponential(8.0)
            for kind, when in (("entry", t), ("exit", t + dwell)):
                x, y = rng.random(2).tolist() if has_positions else (None, None)
                if rng.random() < 0.95:
                    events.append(Event(f"c{camera}", kind, round(when, 2), x, y, track))
            after = int(rng.choice(cameras, p=onward[camera]))
            t += dwell + max(lag[camera, after] + rng.normal(0.0, 0.5), -dwell)
            camera = after
    return sorted(events, key=lambda event: event.t)


@settings(max_examples=12)
@given(st.integers(0, 10**6))
def test_whatever_is_learned_is_read_and_makes_predictions(seed: int) -> None:
    events = any_events(np.random.default_rng(seed))
    learner = Learner(only_last=True)
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None

    topology = decode_topology(to_json(learner.topology))
    for row in rows_of(topology).onward or []:
        assert row.leave + sum(outcome.share for outcome in row.next_) <= 1.0 + 1e-4

    predictor = Predictor(topology)
    for event in events:
        if event.kind == "exit":
            prediction = predictor.predict(event)
            total = prediction.leave + sum(one.probability for one in prediction.next)
            assert total == pytest.approx(1.0)
        predictor.observe(event)
