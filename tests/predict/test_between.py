"""How many objects are between cameras, by the predictions of exits and the matches of entries."""

from __future__ import annotations

from collections import defaultdict

import naive
import numpy as np
import pytest
import scipy.stats
from hypothesis import given, strategies as st

from camtopod.predict import between
from camtopod.predict.between import (
    HORIZON_SECONDS,
    PREDICTION_ERROR,
    BetweenCameras,
    intervals,
)
from camtopod.records import Match, MatchedPassage, NextCamera, Prediction

T = 1_700_000_000.0
CAMERAS = ("lobby", "hall", "yard")


def exit_at(
    camera: str, t: float, *rows: tuple[str, float, float, float, float], track: str | None = None
) -> Prediction:
    """Return the prediction of an exit; rows are camera, probability, q10, q50 and q90."""
    nexts = [NextCamera(to, f"{to}/1", *figures) for to, *figures in rows]
    return Prediction(camera, None, t, track, 9, 1.0 - sum(row[1] for row in rows), nexts)


def entry(camera: str, t: float, *passages: tuple[str, float, float, str | None]) -> Match:
    """Return the match of an entry; passages are camera, time, probability and track."""
    rows = [MatchedPassage(*passage) for passage in passages]
    new = 1.0 - sum(row.probability for row in rows)
    return Match(camera, t, 9, rows, new, f"{camera}@{t}", "1")


def _window(q10: float, first: float, second: float) -> tuple[float, float, float]:
    return q10, q10 + first, q10 + first + second


windows = st.builds(
    _window,
    st.floats(-20.0, 2000.0).filter(lambda q10: abs(q10) > 0.01),
    st.floats(0.01, 1000.0),
    st.floats(0.01, 1000.0),
)
appearances = st.lists(
    st.tuples(st.sampled_from(CAMERAS), st.floats(0.002, 0.3), windows), max_size=3
)
exits = st.lists(
    st.tuples(st.sampled_from(CAMERAS), st.floats(0.0, 900.0), appearances), max_size=6
)
entries = st.lists(
    st.tuples(st.integers(0, 3), st.floats(900.0, 1800.0), st.integers(0, 5), st.floats(0.0, 0.99)),
    max_size=8,
)


@given(exits, entries, st.floats(1800.0, 4400.0))
def test_the_number_is_that_of_each_exit_by_itself(left, came, now) -> None:
    counted = BetweenCameras(T)
    for k, (camera, t, rows) in enumerate(left):
        nexts = [(to, p, *window) for to, p, window in rows]
        counted.left(exit_at(camera, T + t, *nexts, track=str(k)))
    claims = defaultdict(list)
    for number, t, of, probability in came:
        if of < len(left):
            name = CAMERAS[number % 3]
            claims[of].append(((name, t), T + t, probability))
            passage = (left[of][0], T + left[of][1], probability, str(of))
            counted.entered(entry(name, T + t, passage))
    answer = counted.expected(T + now)

    by_pair: dict[tuple[str, str], float] = defaultdict(float)
    for k, (camera, t, rows) in enumerate(left):
        if T + now > T + t + HORIZON_SECONDS:
            continue
        chances = naive.still_to_come(
            T + t, [(p, *window) for _, p, window in rows], claims[k], T + now, HORIZON_SECONDS
        )
        for (to, _, _), chance in zip(rows, chances, strict=True):
            by_pair[camera, to] += chance
    assert answer.number == pytest.approx(sum(by_pair.values()), abs=2e-3)
    pairs = {(row.from_, row.to): row.number for row in answer.pairs}
    for pair, number in by_pair.items():
        assert pairs.get(pair, 0.0) == pytest.approx(number, abs=2e-3)


def test_intervals_are_those_of_a_negative_binomial_number() -> None:
    shape = PREDICTION_ERROR**-2
    assert intervals(np.zeros(1)) == ([0], [0])
    assert intervals(np.zeros(0)) == ([], [])
    for means in (np.geomspace(1e-6, 300.0, 200), np.array([20_000.0])):
        success = shape / (shape + means)
        exact = [scipy.stats.nbinom.ppf(q, shape, success).tolist() for q in (0.1, 0.9)]
        assert list(intervals(means)) == exact


def test_who_has_been_seen_again_is_between_no_more() -> None:
    counted = BetweenCameras(T)
    counted.left(exit_at("lobby", T + 1, ("hall", 0.9, 10, 20, 60), track="7"))
    before = counted.expected(T + 8)
    counted.entered(entry("hall", T + 9, ("lobby", T + 1, 0.98, "7")))
    after = counted.expected(T + 9)
    counted.entered(entry("hall", T + 9, ("lobby", T + 1, 0.0, "7")))

    assert before.number == pytest.approx(0.9, abs=0.03)
    assert [(row.from_, row.to) for row in before.pairs] == [("lobby", "hall")]
    assert after.number < 0.02
    assert counted.expected(T + 9).number > 0.8, "its second match says otherwise"


def test_who_has_been_seen_before_the_exit_is_not_between_cameras() -> None:
    counted = BetweenCameras(T)
    counted.left(exit_at("lobby", T + 1, ("hall", 0.8, -90, -50, -40), ("hall", 0.1, 10, 20, 60)))
    assert counted.expected(T + 2).number == pytest.approx(0.1, abs=0.01)


def test_who_is_long_unseen_has_left() -> None:
    counted = BetweenCameras(T)
    counted.left(exit_at("lobby", T, ("hall", 0.9, 10, 20, 60)))
    numbers = [counted.expected(T + age).number for age in (0, 30, 60, 120, 600)]
    assert numbers == sorted(numbers, reverse=True)
    assert numbers[-1] < 0.01


def test_earlier_exits_and_forgotten_cameras_do_not_count() -> None:
    counted = BetweenCameras(T)
    counted.left(exit_at("lobby", T - 1, ("hall", 0.9, 10, 20, 60)))
    assert counted.expected(T).number == 0.0
    counted.left(exit_at("lobby", T + 1, ("hall", 0.5, 10, 20, 60), ("yard", 0.4, 10, 20, 60)))
    counted.left(exit_at("yard", T + 1, ("hall", 0.9, 10, 20, 60)))
    assert [(row.from_, row.to) for row in counted.expected(T + 2).pairs] == [
        ("yard", "hall"),
        ("lobby", "hall"),
        ("lobby", "yard"),
    ]
    assert len(counted.expected(T + 2, pairs_max=1).pairs) == 1

    counted.forget_cameras({"yard", "never"})

    assert [(row.from_, row.to) for row in counted.expected(T + 2).pairs] == [("lobby", "hall")]


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(between, "EXITS_MAX", 10)
    counted = BetweenCameras(T)
    for _ in range(30):
        counted.left(exit_at("lobby", T, ("hall", 0.5, 10, 20, 60), ("yard", 0.5, 10, 20, 60)))
    assert counted.expected(T).number == pytest.approx(10.0)

    # Entries that may be of one exit are added up.
    few, many = BetweenCameras(T), BetweenCameras(T)
    for one in (few, many):
        one.left(exit_at("lobby", T, ("hall", 0.9, 10, 20, 60)))
    for k in range(15):
        few.entered(entry("hall", T + k, ("lobby", T, 0.2, None)))
    monkeypatch.setattr(between, "CLAIMS_MAX", 2)
    for k in range(15):
        many.entered(entry("hall", T + k, ("lobby", T, 0.2, None)))
    assert many.expected(T + 15) == few.expected(T + 15)
    assert 0.0 < few.expected(T + 15).number < 0.1

    monkeypatch.setattr(between, "APPEARANCES_MAX", 6)
    counted.left(exit_at("lobby", T, ("hall", 0.5, 10, 20, 60), ("yard", 0.5, 10, 20, 60)))
    assert counted.expected(T).number == pytest.approx(3.0)
    assert counted.expected(T + HORIZON_SECONDS + 1).number == 0.0
