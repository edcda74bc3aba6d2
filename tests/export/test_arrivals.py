"""Who is about to come where, and which entries are one walk."""

from __future__ import annotations

import pytest

from camtopod.export import arrivals
from camtopod.export.arrivals import Awaited, ExpectedArrivals
from camtopod.records import Look, Match, MatchedPassage, NextCamera, Prediction

T = 1_700_000_000.0


def exit_at(
    camera: str,
    t: float,
    *rows: tuple[str, float, float, float],
    look: list[Look] | None = None,
    track: str | None = None,
) -> Prediction:
    """Return the prediction of an exit; rows are camera, probability, q10 and q90."""
    nexts = [NextCamera(to, f"{to}/1", share, q10, q10, q90) for to, share, q10, q90 in rows]
    leave = 1.0 - sum(row[1] for row in rows)
    return Prediction(camera, f"{camera}/1", t, track, 9, leave, nexts, look)


def entry(
    camera: str,
    t: float,
    walk: str,
    *passages: tuple[str, float, float] | tuple[str, float, float, str],
    track: str | None = None,
) -> Match:
    """Return the match of an entry; passages are camera, time and probability."""
    rows = [MatchedPassage(*passage) for passage in passages]
    return Match(camera, t, 9, rows, 1.0 - sum(row.probability for row in rows), walk, track)


def test_somebody_is_expected_until_nine_of_ten_have_come() -> None:
    seen = ExpectedArrivals()
    seen.left(exit_at("lobby", T, ("hall", 0.6, 5, 9), ("hall", 0.2, 20, 30), ("yard", 0.1, 3, 4)))

    now = seen.expected(T + 4)
    later = seen.expected(T + 9.1)

    assert now["hall"] == Awaited(pytest.approx(0.8), "lobby", T + 5, T + 9)
    assert now["yard"] == Awaited(pytest.approx(0.1), "lobby", T + 3, T + 4)
    assert later == {"hall": Awaited(pytest.approx(0.2), "lobby", T + 20, T + 30)}
    assert seen.expected(T + 31) == {}


def test_no_times_are_told_that_are_not_known() -> None:
    seen = ExpectedArrivals()
    guessed = [NextCamera("hall", "hall/1", 0.9, 0.0, 300.0, 600.0, prior=True)]
    seen.left(Prediction("lobby", "lobby/1", T, None, 9, 0.1, guessed))

    assert seen.expected(T + 599) == {"hall": Awaited(pytest.approx(0.9), "lobby", None, None)}
    assert seen.expected(T + 601) == {}


def test_several_may_come() -> None:
    """Nobody comes only if none of them does; times are those of the likeliest one."""
    seen = ExpectedArrivals()
    seen.left(exit_at("lobby", T, ("hall", 0.5, 5, 9)))
    seen.left(exit_at("yard", T + 1, ("hall", 0.6, 1, 9)))
    seen.left(exit_at("stairs", T + 2, ("hall", 0.2, 5, 9)))

    assert seen.expected(T + 3) == {
        "hall": Awaited(pytest.approx(1 - 0.5 * 0.4 * 0.8), "yard", T + 2, T + 10)
    }


def test_who_has_been_seen_again_is_not_expected_any_more() -> None:
    seen = ExpectedArrivals()
    seen.left(exit_at("lobby", T, ("hall", 0.6, 5, 60), ("yard", 0.4, 5, 60)))

    seen.entered(entry("yard", T + 7, "lobby@1", ("lobby", T, 0.9)))
    after = seen.expected(T + 8)
    seen.entered(entry("yard", T + 7, "yard@1", ("lobby", T, 0.25), ("lobby", T - 50, 0.25)))
    revised = seen.expected(T + 18)
    seen.entered(entry("hall", T + 20, "lobby@1", ("lobby", T, 0.9)))
    gone = seen.expected(T + 21)

    assert after["hall"].probability == pytest.approx(0.06)
    assert revised["hall"].probability == pytest.approx(0.45)
    assert gone["hall"].probability == gone["yard"].probability == 0.0


def test_where_to_look_is_where_the_object_is_seen_again() -> None:
    seen = ExpectedArrivals()
    seen.left(exit_at("lobby", T, ("hall", 0.6, 5, 20), ("yard", 0.4, 5, 60)))
    assert seen.looks(T + 20) == {"hall": Awaited(pytest.approx(0.6), "lobby", T, T + 20)}
    assert seen.looks(T + 21) == {}

    seen.entered(entry("yard", T + 30, "lobby@1", ("lobby", T, 0.9)))
    assert seen.looks(T + 31) == {"yard": Awaited(0.9, "lobby", T + 30, T + 40)}
    assert seen.looks(T + 41) == {}


def test_where_views_overlap_the_object_is_in_view_already() -> None:
    seen = ExpectedArrivals()
    seen.left(exit_at("lobby", T, ("hall", 0.9, -8, -2), look=[Look("hall", 0.95), Look("a", 0.3)]))

    assert seen.expected(T) == {}
    assert seen.looks(T + 9) == {"hall": Awaited(0.95, "lobby", T, T + arrivals.LOOK_SECONDS)}
    assert seen.looks(T + 11) == {}


def test_a_walk_has_its_entries_in_order_and_a_second_match_moves_one() -> None:
    seen = ExpectedArrivals()
    seen.entered(entry("lobby", T, "lobby@1", track="7"))
    hall = seen.entered(entry("hall", T + 20, "hall@1"))
    yard = seen.entered(entry("yard", T + 15, "lobby@1", ("lobby", T + 3, 0.8)))
    moved = seen.entered(entry("hall", T + 20, "lobby@1", ("yard", T + 18, 0.8)))
    back = seen.entered(entry("yard", T + 15, "yard@1"))

    assert (hall.again, yard.again, moved.again, back.again) == (False, False, True, True)
    assert (hall.was, yard.was, moved.was, back.was) == (None, None, "hall@1", None)
    assert [one.camera for one in hall.passages] == ["hall"]
    assert [one.camera for one in yard.passages] == ["lobby", "yard"]
    assert [one.camera for one in moved.passages] == ["lobby", "yard", "hall"]
    assert [one.camera for one in back.passages] == ["yard"]


def test_a_walk_of_hours_keeps_its_entries_under_its_newest_name() -> None:
    """It is named by its oldest passage of the last hour."""
    seen = ExpectedArrivals()
    seen.entered(entry("hall", T + 10, "lobby@1", ("lobby", T, 0.9)))
    seen.entered(entry("yard", T + 20.5, "lobby@1", ("hall", T + 15, 0.9)))

    last = seen.entered(entry("gate", T + 30, f"yard@{T + 20.5}", ("yard", T + 25, 0.9)))

    assert [match.camera for match in last.passages] == ["yard", "gate"]
    assert {match.walk for match in last.passages} == {f"yard@{T + 20.5}"}


def test_a_forgotten_camera_is_in_no_walk_and_nobody_is_expected_from_or_at_it() -> None:
    seen = ExpectedArrivals()
    seen.left(exit_at("lobby", T, ("hall", 0.6, 5, 60)))
    seen.left(exit_at("yard", T, ("lobby", 0.7, 5, 60), ("hall", 0.3, 5, 60)))
    seen.left(
        exit_at("gate", T, ("hall", 0.9, 5, 60), look=[Look("lobby", 0.9), Look("hall", 0.1)])
    )
    seen.entered(entry("lobby", T + 6, "hall@1", ("yard", T, 0.9)))
    seen.entered(entry("hall", T + 15, "hall@1", ("stairs", T + 12, 0.9)))
    seen.entered(entry("yard", T + 15, "yard@1"))

    seen.forget_cameras({"lobby"})
    after = seen.expected(T + 20)
    looks = seen.looks(T + 10)
    stairs = seen.entered(entry("stairs", T + 20, "hall@1", ("hall", T + 18, 0.9)))
    yard = seen.entered(entry("gate", T + 20, "yard@1", ("yard", T + 18, 0.9)))

    assert after == {"hall": Awaited(pytest.approx(1 - 0.7 * 0.1), "gate", T + 5, T + 60)}
    assert looks == {}
    assert [match.camera for match in stairs.passages] == ["stairs"]
    assert [match.camera for match in yard.passages] == ["yard", "gate"]


def test_two_exits_of_one_moment_are_two() -> None:
    """Two who leave a view side by side leave it in the same frame."""
    seen = ExpectedArrivals()
    for track in ("7", "8"):
        seen.left(exit_at("lobby", T, ("hall", 0.5, 5, 60), track=track))
    assert seen.expected(T)["hall"].probability == pytest.approx(0.75)

    seen.entered(entry("hall", T + 6, "lobby@1", ("lobby", T, 1.0, "7"), track="3"))
    seen.entered(entry("hall", T + 6, "lobby@1/2", ("lobby", T, 0.4, "8"), track="4"))
    assert seen.expected(T + 7)["hall"].probability == pytest.approx(0.3)


def test_two_entries_of_one_moment_are_two() -> None:
    seen = ExpectedArrivals()
    first, second = f"lobby@{T}", f"lobby@{T}/2"
    seen.entered(entry("lobby", T, first, track="7"))
    beside = seen.entered(entry("lobby", T, second, track="8"))
    assert beside.again is False
    assert [match.track for match in beside.passages] == ["8"]

    later = seen.entered(entry("hall", T + 9, first, ("lobby", T + 3, 0.9), track="3"))
    assert [match.track for match in later.passages] == ["7", "3"]


def test_nothing_is_remembered_for_more_than_an_hour(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrivals, "EXITS_MAX", 2)
    monkeypatch.setattr(arrivals, "ENTRIES_MAX", 2)
    seen = ExpectedArrivals()
    for camera in ("a", "b", "c"):
        seen.left(exit_at(camera, T, (camera, 0.9, 5, 9000)))
        seen.entered(entry(camera, T, "walk"))
    seen.left(exit_at("d", float("inf"), ("d", 0.9, 5, 9)))

    seen.forget(T + 3599)
    assert set(seen.expected(T + 3599)) == {"c"}
    assert len(seen.entered(entry("d", T + 3599, "walk")).passages) == 3
    seen.forget(T + 3601)
    assert seen.expected(T + 3601) == {}
    assert len(seen.entered(entry("e", T + 3601, "walk")).passages) == 2
