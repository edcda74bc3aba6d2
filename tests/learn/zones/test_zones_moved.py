"""A camera that is turned gets new zones; nothing else is mistaken for that."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.learn.changes.camera_moved import find_moves
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.zones.cells import cell_sums, cells_of, fixed_point
from camtopod.learn.zones.zone_map import find_zones
from camtopod.records import Event
from camtopod.topology import weak_links

BEFORE = [(0.05, 0.5), (0.5, 0.95), (0.9, 0.3)]
AFTER = [(0.3, 0.1), (0.7, 0.7), (0.2, 0.8)]


def places(
    seed: int, doors: list[tuple[float, float]], shares: list[float], n: int, clutter: float = 0.2
) -> np.ndarray:
    rng = np.random.default_rng(seed)
    door = np.array(doors)[rng.choice(len(doors), n, p=shares)] + 0.02 * rng.standard_normal((n, 2))
    return np.clip(np.where(rng.random((n, 1)) < clutter, rng.random((n, 2)), door), 0, 1)


def first_look(before: np.ndarray, after: np.ndarray) -> int | None:
    """Return after how many events a move is detected, checking every 25; None: never."""
    table = find_zones(cell_sums(*fixed_point(before.T))).cells
    cell = cells_of(*fixed_point(np.concatenate([before, after]).T))
    looks = range(len(before) + 25, len(cell) + 1, 25)
    return next((at - len(before) for at in looks if find_moves([cell[:at]], [table])[0]), None)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("n", [200, 2000])
def test_a_turned_camera_is_seen_within_a_hundred_events(seed: int, n: int) -> None:
    before = places(seed, BEFORE, [0.5, 0.3, 0.2], n)
    after = places(seed + 100, AFTER, [0.4, 0.4, 0.2], 200)
    seen = first_look(before, after)
    assert seen is not None
    assert seen <= 100
    table = find_zones(cell_sums(*fixed_point(before.T))).cells
    move = find_moves([cells_of(*fixed_point(np.concatenate([before, after]).T))], [table])[0]
    assert move is not None
    assert abs(move.first - n) <= 20
    assert move.outside > 0.8
    assert move.stay_share < 0.2


def test_cameras_tested_together_do_not_disturb_each_other() -> None:
    before = places(0, BEFORE, [0.5, 0.3, 0.2], 500)
    table = find_zones(cell_sums(*fixed_point(before.T))).cells
    cells = [
        cells_of(*fixed_point(np.concatenate([before, after]).T))
        for after in (
            places(1, AFTER, [0.4, 0.4, 0.2], 200),
            places(2, BEFORE, [0.5, 0.3, 0.2], 200),
            places(3, AFTER, [0.4, 0.4, 0.2], 90),
            places(4, BEFORE[:1], [1.0], 400),
            np.zeros((0, 2)),
        )
    ]
    tables = [table, table, table, table, np.full_like(table, -1)]
    alone = [find_moves([cell], [zones])[0] for cell, zones in zip(cells, tables, strict=True)]
    assert find_moves(cells, tables) == alone
    assert [move is not None for move in alone] == [True, False, True, False, False]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("doors", "shares", "clutter"),
    [
        (BEFORE, [0.5, 0.3, 0.2], 0.2),  # as before
        (BEFORE, [0.05, 0.1, 0.85], 0.2),  # other doors busy
        (BEFORE, [0.5, 0.3, 0.2], 0.7),  # hardly anybody, as much clutter
        (BEFORE, [0.0, 0.6, 0.4], 0.2),  # one closed
        ([*BEFORE, (0.3, 0.1)], [0.25, 0.15, 0.1, 0.5], 0.2),  # one opened
        ([*BEFORE, (0.3, 0.1)], [0.0, 0.3, 0.2, 0.5], 0.2),  # both
    ],
)
def test_other_changes_are_no_move(
    seed: int, doors: list[tuple[float, float]], shares: list[float], clutter: float
) -> None:
    before = places(seed, BEFORE, [0.5, 0.3, 0.2], 1000)
    assert first_look(before, places(seed + 100, doors, shares, 400, clutter)) is None


def walks(seed: int, start: float, n: int, doors: list[tuple[float, float]]) -> list[Event]:
    """Return people who leave camera a at its first door and appear in b 8 s later.

    Others come and go in a.
    """
    rng = np.random.default_rng(seed)
    made, t = list[Event](), start
    for k in range(n):
        t += rng.exponential(40.0)
        came, left = (
            np.clip(np.array(doors[d]) + 0.015 * rng.standard_normal(2), 0, 1)
            for d in (1 + k % 2, 0)
        )
        there, gone = (
            np.clip(np.array(p) + 0.015 * rng.standard_normal(2), 0, 1)
            for p in ((0.1, 0.2), (0.9, 0.9))
        )
        lag = 8.0 + rng.normal()
        made += [Event("a", "entry", t, *came, track=k), Event("a", "exit", t + 6, *left, track=k)]
        made += [
            Event("b", "entry", t + 6 + lag, *there, track=k),
            Event("b", "exit", t + 12 + lag, *gone, track=k),
        ]
    return sorted(made, key=lambda event: event.t)


def test_learner_starts_a_turned_camera_anew_and_says_so() -> None:
    learner = Learner(Settings())
    for event in walks(0, 0.0, 300, BEFORE):
        learner.receive(event)
    learner.flush()
    before = learner.topology
    assert before is not None
    old = next(camera.zones for camera in before.cameras if camera.id == "a")
    assert len(old) == 3
    assert any(link.from_ in old and link.to.startswith("b/") for link in before.links)
    for event in walks(1, before.as_of, 150, AFTER):
        learner.receive(event)
    learner.flush()
    after = learner.topology
    assert after is not None
    zones = {camera.id: camera.zones for camera in after.cameras}
    assert zones["b"] == next(camera.zones for camera in before.cameras if camera.id == "b")
    assert len(zones["a"]) == 3
    assert not set(zones["a"]) & set(old)
    places_now = np.array([(zone.x, zone.y) for zone in after.zones if zone.camera == "a"])
    assert (np.abs(places_now[:, None] - np.array(AFTER)).max(axis=2).min(axis=1) < 0.02).all()
    assert not any({link.from_, link.to} & set(old) for link in [*after.links, *weak_links(after)])
    assert any(link.from_ in zones["a"] and link.to.startswith("b/") for link in after.links)
    moved = [alarm for alarm in after.alarms or [] if alarm.kind == "camera_moved"]
    assert [alarm.subject for alarm in moved] == ["a"]


def test_a_turned_camera_is_told_in_the_one_version_of_a_recording() -> None:
    learner = Learner(Settings(), only_last=True)
    events = walks(0, 0.0, 300, BEFORE)
    for event in [*events, *walks(1, events[-1].t, 300, AFTER)]:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    moved = [one.subject for one in learner.topology.alarms or [] if one.kind == "camera_moved"]
    assert moved == ["a"]
    zones = np.array([(zone.x, zone.y) for zone in learner.topology.zones if zone.camera == "a"])
    assert (np.abs(zones[:, None] - np.array(AFTER)).max(axis=2).min(axis=1) < 0.02).all()
