"""The sliding window: which events are held, and which entry began the passage of an exit."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, strategies as st

from camtopod.event_time import microseconds
from camtopod.learn.window import sliding_window as module
from camtopod.learn.window.sliding_window import (
    FLOOD_CAMERAS_MIN,
    FLOOD_SHARE,
    NONE,
    Window,
)
from camtopod.learn.zones.cells import cells_of
from camtopod.records import Event
from camtopod.topology.grid import GRID_COLUMNS, GRID_ROWS, POSITION_ONE

PLACES = st.one_of(
    st.none(), st.tuples(*[st.floats(0, 1)] * 2), st.sampled_from([(0.0, 0.0), (1.0, 1.0)])
)


@st.composite
def event(draw: st.DrawFn) -> Event:
    x, y = draw(PLACES) or (None, None)
    track = draw(st.sampled_from([None, "1", "2"]))
    return Event(
        draw(st.sampled_from("abc")), draw(st.sampled_from(["entry", "exit"])), 0.0, x, y, track
    )


STEPS = st.lists(
    st.tuples(st.lists(event(), max_size=12), st.integers(0, 30), st.booleans()), max_size=12
)
"""Batches, each a few seconds after the one before, and how old an event may be after it."""


def at(t: float, batch: list[Event]) -> list[tuple[int, Event]]:
    return [(microseconds(t), e) for e in batch]


def bounded(
    kept: list[tuple[int, Event]], events_max: int, seen: list[Event]
) -> list[tuple[int, Event]]:
    """Return the part of a window that remains: cameras that flood lose events first."""
    cameras = list(dict.fromkeys(e.camera for e in seen))
    held = [sum(e.camera == camera for _, e in kept) for camera in cameras]
    wild = cameras[held.index(max(held))] if len(cameras) >= FLOOD_CAMERAS_MIN else ""
    while len(kept) > events_max:
        mine = [k for k, (_, e) in enumerate(kept) if e.camera == wild]
        del kept[mine[0] if len(mine) > int(FLOOD_SHARE * events_max) else 0]
    return kept


@given(STEPS, st.integers(1, 25))
def test_the_newest_events_are_held(
    steps: list[tuple[list[Event], int, bool]], events_max: int
) -> None:
    window, kept, seen, now = Window(events_max), list[tuple[int, Event]](), list[Event](), 0
    for batch, age, forget in steps:
        now += 5
        window.append(at(now, batch))
        kept += at(now, batch)
        seen += batch
        if forget:
            remaining = bounded(
                [(t, e) for t, e in kept if t >= microseconds(now - age)], events_max, seen
            )
            assert window.forget_old(microseconds(now - age)) == len(kept) - len(remaining)
            kept = remaining

        assert len(window) == len(kept)
        assert window.column("t").tolist() == [t for t, _ in kept]
        assert [window.cameras[k] for k in window.column("camera")] == [e.camera for _, e in kept]
        assert [rows.tolist() for rows in window.rows_of_cameras()] == [
            [k for k, (_, e) in enumerate(kept) if e.camera == name] for name in window.cameras
        ]
        assert window.column("entry").tolist() == [e.kind == "entry" for _, e in kept]
        assert window.has_position().tolist() == [e.x is not None for _, e in kept]
        for camera, name in enumerate(window.cameras):
            assert window.seen[camera] == sum(e.camera == name and e.x is not None for e in seen)


@given(STEPS)
def test_mates(steps: list[tuple[list[Event], int, bool]]) -> None:
    """An exit's mate is the newest event of its camera and track, if that is an entry
    in the window.
    """
    window, events, now = Window(1000), list[Event](), 0
    for batch, age, _ in steps:
        now += 5
        window.append(at(now, batch))
        events += batch
        window.forget_old(microseconds(now - age))
    base = len(events) - len(window)
    assert window.state.base == base
    found = window.column("mate").tolist()
    for row, mate in enumerate(naive.mates(events)[base:]):
        assert found[row] == NONE or found[row] == mate
        if mate is None:
            assert found[row] == NONE
        elif mate >= base:
            assert found[row] == mate


def test_open_passages_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "OPEN_PASSAGES_MAX", 2)
    window = Window(1000)
    window.append(at(1, [Event("a", "entry", 1, track=k) for k in ("1", "2", "3")]))
    window.append(at(2, [Event("a", "exit", 2, track=k) for k in ("1", "2", "3")]))
    assert window.column("mate").tolist() == [-1, -1, -1, -1, 1, 2]


def test_at_most_so_many_of_each_camera_if_that_is_more() -> None:
    window, now = Window(7, 3, 1000), 0
    for cameras, held in ((1, 7), (2, 7), (3, 9), (6, 18)):
        for k in range(10):
            now += 1
            window.append(
                at(now, [Event(f"c{(k + c) % cameras}", "entry", now) for c in range(cameras)])
            )
            window.forget_old(0)
        assert window.events_max == len(window) == held
    for most, held in ((1000, 18), (10, 10)):
        again = Window(7, 3, most, window.state)
        assert again.events_max == held


@given(st.floats(0, 1), st.floats(0, 1))
def test_cells_hold_what_the_zones_see(x: float, y: float) -> None:
    """The cell is that of the fixed-point position."""
    px, py = round(x * POSITION_ONE), round(y * POSITION_ONE)
    (cell,) = cells_of(np.array([px]), np.array([py]))
    row, column = divmod(int(cell), GRID_COLUMNS)
    assert row <= y * GRID_ROWS + 0.01 <= row + 1.02
    assert column <= x * GRID_COLUMNS + 0.01 <= column + 1.02
    assert cells_of(np.array([-1]), np.array([py])).tolist() == [-1]


def test_a_camera_that_floods_displaces_only_itself() -> None:
    window = Window(1000)
    quiet = [(10 * k, Event("ab"[k % 2], "entry", k, 0.5, 0.5)) for k in range(100)]
    flood = [(5 * k, Event("wild", "entry", k, 0.1, 0.1)) for k in range(4000)]
    for first in range(0, 20_000, 500):
        batch = [row for row in quiet + flood if first <= row[0] < first + 500]
        window.append(sorted(batch, key=lambda row: row[0]))
        window.forget_old(0)
    assert len(window) == 1000
    held = dict(zip(window.cameras, window.events_of_cameras().tolist(), strict=True))
    assert held == {"a": 50, "b": 50, "wild": 900}
    wild = window.column("camera") == window.cameras.index("wild")
    assert window.column("t")[wild].tolist() == [t for t, _ in flood][-900:]


def test_two_busy_cameras_and_a_busy_one_of_two_are_no_flood() -> None:
    for names, share in (("abc", (0.6, 0.3, 0.1)), ("ab", (0.95, 0.05))):
        window = Window(500)
        chance = np.random.default_rng(1)
        chosen = chance.choice(list(names), 2000, p=share)
        window.append([(k, Event(str(name), "entry", k)) for k, name in enumerate(chosen)])
        window.forget_old(0)
        assert window.column("t").tolist() == list(range(1500, 2000))


@pytest.mark.parametrize("turned", [False, True])
def test_passages_whose_entry_is_forgotten_are_no_longer_open(turned: bool) -> None:
    window = Window(1000)
    for t in range(50):
        window.append(at(t, [Event(camera, "entry", t, 0.5, 0.5, str(t)) for camera in "ab"]))
        window.append(at(t, [Event("a", "entry", t, 0.5, 0.5, "again")]))
        window.forget_old(microseconds(t - 10))
        if turned and t == 25:
            window.forget_camera(0, len(window) - 4)
    rows = list(window.state.open.values())
    assert rows == sorted(rows)
    assert window.state.base <= rows[0]
    assert len(rows) == 23, "11 seconds of two cameras, and one that came again and again"


@given(st.lists(event(), min_size=1, max_size=30), st.integers(0, 30))
def test_one_camera_forgets_and_the_passages_of_the_others_stay(
    events: list[Event], before: int
) -> None:
    window = Window(100)
    window.append([(t, e) for t, e in enumerate(events)])
    row = window.entries_of_exits()
    began = np.where(row >= 0, row, -1)
    stays = (np.arange(len(events)) >= before) | (window.column("camera") != 0)

    window.forget_camera(0, before)

    t = window.column("t")
    assert t.tolist() == np.flatnonzero(stays).tolist()
    row = window.entries_of_exits()
    now = np.where(row >= 0, t[np.maximum(row, 0)], -1)
    expected = np.where((began >= 0) & stays[began], began, -1)
    assert now.tolist() == expected[stays].tolist()
    camera = window.column("camera")
    for k, rows in enumerate(window.rows_of_cameras()):
        assert rows.tolist() == np.flatnonzero(camera == k).tolist()


def labelled(k: int, label: str | None, kind: str = "entry", track: str | None = None) -> Event:
    return Event("a", kind, float(k), track=track, label=label)


def test_the_most_frequent_labels_count_and_ties_go_by_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "LABELS_MAX", 2)
    window = Window(100)
    for k, label in enumerate(["van", "Car", "car", None, "bus", " ", "c-a-r"]):
        window.append(at(k, [labelled(k, label)]))

    names, label = window.labels()

    assert names == ["bus", "car"]
    assert label.tolist() == [-1, 1, 1, -1, 0, -1, 1]


def test_an_exit_without_a_label_has_its_entrys() -> None:
    window = Window(100)
    window.append(at(0, [labelled(0, "car", track="1"), labelled(0, "bus", track="2")]))
    window.append(at(1, [labelled(1, None, "exit", "1"), labelled(1, "car", "exit", "2")]))
    window.append(at(2, [labelled(2, None, "exit", "3")]))

    names, label = window.labels()

    assert [names[k] if k >= 0 else None for k in label] == ["car", "bus", "car", "car", None]


def test_labels_that_are_gone_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plates by mistake, each seen once, take no memory for long."""
    monkeypatch.setattr(module, "LABELS_REMEMBERED", 3)
    window = Window(3)
    for k in range(50):
        window.append(at(k, [labelled(k, f"kind{k}")]))
        window.forget_old(0)

    assert window.state.labels == ["kind47", "kind48", "kind49"]
    assert window.column("label").tolist() == [0, 1, 2]
    assert window.labels()[0] == ["kind47", "kind48", "kind49"]
