"""Likely neighbours, by a coarse look at the events of a window."""

from __future__ import annotations

import random
from itertools import pairwise

import numpy as np
import pytest

from camtopod.city.neighbours import chance_excess, likely_neighbours
from camtopod.records import Event

HOUR = 3600.0


def strollers(cameras: int, seed: int, one_way: bool = False) -> list[Event]:
    """Return an hour's events: of every camera's own visitors, and of those between neighbours.

    Cameras 0 and 1 are neighbours, 2 and 3, and so on.
    """
    chance = random.Random(seed)
    events = []
    for camera in range(cameras):
        for kind in ("entry", "exit"):
            events += [
                Event(f"c{camera}", kind, chance.uniform(0, HOUR))  # type: ignore[arg-type]
                for _ in range(100)
            ]
    for first, second in pairwise(range(cameras)):
        for _ in range(80 if first % 2 == 0 else 0):
            way = (first, second) if one_way or chance.random() < 0.5 else (second, first)
            left = chance.uniform(0, HOUR)
            events.append(Event(f"c{way[0]}", "exit", left))
            events.append(Event(f"c{way[1]}", "entry", left + chance.gauss(15, 2)))
    return sorted(events, key=lambda event: event.t)


@pytest.mark.parametrize("one_way", [False, True])
def test_neighbours_are_found_and_few_others(one_way: bool) -> None:
    true = {tuple(sorted((f"c{k}", f"c{k + 1}"))) for k in range(0, 60, 2)}

    likely = likely_neighbours(strollers(60, 1, one_way))

    assert len(true & likely.keys()) >= 28
    assert len(likely.keys() - true) <= 45
    clear = sorted(likely, key=lambda pair: likely[pair])[-20:]
    assert true >= {*clear}


def test_unrelated_cameras_have_one_neighbour_by_chance() -> None:
    chance = random.Random(3)
    events = [
        Event(f"c{chance.randrange(80)}", chance.choice(("entry", "exit")), chance.uniform(0, HOUR))  # type: ignore[arg-type]
        for _ in range(16_000)
    ]

    likely = likely_neighbours(sorted(events, key=lambda event: event.t))

    assert 10 <= len(likely) <= 60  # of 3,160 pairs; 40 if the bulk told the tail exactly


def test_the_tail_follows_from_the_bulk() -> None:
    excess = np.random.default_rng(1).gumbel(3.0, 0.5, 200 * 199 // 2)

    assert (excess > chance_excess(excess)).sum() == pytest.approx(100, abs=35)


@pytest.mark.parametrize(
    "events",
    [
        [],
        [Event("a", "entry", 1.0)],
        [Event("a", "exit", 1.0), Event("a", "entry", 3.0)],
        [Event("a", "exit", 1.0), Event("b", "entry", 3.0)],
    ],
)
def test_few_events_have_no_likely_neighbours(events: list[Event]) -> None:
    assert likely_neighbours(events) == {}
