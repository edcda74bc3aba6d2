"""A tracker that breaks tracks up is noticed; one that does not is not accused."""

from __future__ import annotations

import random

import pytest

from camtopod.adapt import Fragmentation
from camtopod.records import Event


def passage(t: float, pieces: int, name: str) -> list[Event]:
    """Return a way from the left to the right border in 20 s, broken into pieces."""
    events = []
    for n in range(pieces):
        for kind, share in (("entry", n / pieces), ("exit", (n + 0.97) / pieces)):
            at = t + 20 * share
            events.append(Event("lobby", kind, at, 0.02 + 0.96 * share, 0.5, f"{name}-{n}"))  # type: ignore[arg-type]
    return events


def warnings(events: list[Event]) -> list[str]:
    judge = Fragmentation()
    return [warning for event in events if (warning := judge.note(event)) is not None]


@pytest.mark.parametrize("late", [False, True])
def test_broken_tracks_are_said_once_with_counts(late: bool) -> None:
    """As many as 534 events of 27 passages; exits may come after the entries that follow them."""
    events = [event for n in range(27) for event in passage(60.0 * n, 10, f"{n}")]
    if late:
        events.sort(key=lambda event: event.t + 2.2 * (event.kind == "exit"))
    assert len(events) == 540
    (said,) = warnings(events)
    assert said.startswith("camera lobby: 1")
    assert "of 20 entries begin in mid-view" in said
    assert "track_buffer" in said


def test_whole_tracks_are_not_accused_even_in_a_crowd() -> None:
    draw = random.Random(3)
    events = [e for n in range(300) for e in passage(draw.uniform(0, 900), 1, f"{n}")]
    assert warnings(sorted(events, key=lambda event: event.t)) == []


def test_a_door_in_mid_view_is_not_a_broken_track() -> None:
    """People come out of a door and go in, seldom within two seconds of each other."""
    draw = random.Random(5)
    events = []
    for n in range(200):
        t = draw.uniform(0, 8000)
        events.append(Event("lobby", "entry", t, 0.5, 0.5, f"{n}"))
        events.append(Event("lobby", "exit", t + draw.uniform(20, 99), 0.52, 0.5, f"{n}"))
    assert warnings(sorted(events, key=lambda event: event.t)) == []
