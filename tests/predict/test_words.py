"""Predictions in words."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from camtopod.records import InView, Match, MatchedPassage, NextCamera, Prediction

HALL = NextCamera("hall", "hall/2", 0.41, 6.2, 7.9, 10.4)


@pytest.mark.parametrize(
    ("q10", "q90", "words"),
    [
        (6.2, 10.4, "in 6 to 10 s"),
        (-18.0, -16.0, "in view now"),
        (-1.0, 0.4, "in view now"),
        (-2.0, 4.4, "within 4 s"),
        (-0.1, 0.6, "within 1 s"),
    ],
)
def test_no_time_is_negative(q10: float, q90: float, words: str) -> None:
    assert NextCamera("hall", "hall/2", 0.4, q10, q10, q90).when == words


def test_a_camera_is_named_once_with_its_likeliest_times() -> None:
    other = NextCamera("hall", "hall/1", 0.2, 60.0, 70.0, 80.0)
    said = Prediction("lobby", "lobby/1", 1.0, "17", 9, 0.39, [HALL, other])
    assert str(said) == "hall 61 %, in 6 to 10 s; leaves the site 39 %"


def test_at_most_three_outcomes_are_said() -> None:
    rest = [NextCamera(name, f"{name}/1", 0.1, 1.0, 2.0, 3.0) for name in ("bar", "yard")]
    said = Prediction("lobby", "lobby/1", 1.0, "17", 9, 0.39, [HALL, *rest])
    words = "most likely hall 41 %, in 6 to 10 s; leaves the site 39 %; bar 10 %, in 1 to 3 s"
    assert str(said) == words
    alone = Prediction("lobby", "lobby/1", 1.0, "17", 9, 0.995, [replace(HALL, probability=0.005)])
    assert str(alone) == "leaves the site 100 %"


def test_who_is_seen_elsewhere_is_in_view_now() -> None:
    seen = [InView("hall", "1", 1.0, 0.5), InView("yard", "2", 1.0, 0.1)]
    both = [*seen, InView("hall", "3", 1.0, 0.25)]
    said = Prediction("lobby", "lobby/1", 1.0, "17", 9, 0.59, [HALL], None, both)
    assert str(said) == "hall 75 %, in view now; otherwise leaves the site 59 %"


def test_what_may_follow_keeps_the_probabilities_of_the_prediction() -> None:
    seen = [InView("hall", "1", 1.0, 0.8), InView("yard", "2", 1.0, 0.6)]
    bar = NextCamera("bar", "bar/1", 0.3, 1.0, 2.0, 3.0)
    prediction = Prediction("lobby", "lobby/1", 1.0, "17", 9, 0.1, [HALL, bar], None, seen)
    words = "hall 80 %, in view now; yard 60 %, in view now; otherwise bar 30 %, in 1 to 3 s"
    assert str(prediction) == words, "and a camera that sees the object is named once"
    one = replace(prediction, in_view=seen[:1])
    words = "hall 80 %, in view now; otherwise bar 30 %, in 1 to 3 s; leaves the site 10 %"
    assert str(one) == words
    assert str(replace(one, prior=True)) == words.rpartition(";")[0]
    third = [*seen, InView("gate", "3", 1.0, 0.7)]
    assert "otherwise" not in str(replace(prediction, in_view=third))


def test_an_object_may_come_back() -> None:
    back = NextCamera("lobby", "lobby/2", 0.6, 1.0, 2.0, 3.0)
    said = Prediction("lobby", "lobby/1", 1.0, "17", 9, 0.4, [back])
    assert str(said) == "back to lobby 60 %, in 1 to 3 s; leaves the site 40 %"


def test_without_any_evidence_nothing_is_claimed() -> None:
    assert str(Prediction("lobby", None, 1.0, "17", 9, 1.0, [])) == "not known yet"


def test_a_match_says_where_the_object_came_from() -> None:
    passages = [MatchedPassage("yard", 1.0, 0.22), MatchedPassage("hall", 2.0, 0.15)]
    rest = [MatchedPassage("bar", 3.0, 0.004), MatchedPassage("gate", 4.0, 0.1)]
    match = Match("lobby", 9.0, 3, [*passages, *rest], 0.526, "yard:1")
    assert str(match) == "lobby: new 53 %; from yard 22 %; from hall 15 %"
    assert str(replace(match, new=0.0, from_=passages[:1])) == "lobby: from yard 22 %"
    twice = [*passages, MatchedPassage("hall", 5.0, 0.21)]
    two = replace(match, new=0.42, from_=twice, track="56")
    assert str(two) == "lobby, track 56: new 42 %; from hall 36 %; from yard 22 %"


def test_the_earlier_name_of_the_next_cameras_still_works() -> None:
    said = Prediction("lobby", "lobby/1", 1.0, "17", 9, 0.4, [HALL])
    with pytest.warns(DeprecationWarning, match="is next"):
        assert said.candidates == [HALL]
