"""The window under late events, beside a list of rows that is sorted after each step."""

from __future__ import annotations

from typing import Any

from hypothesis import given, strategies as st

from camtopod.learn.window.sliding_window import FLOOD_CAMERAS_MIN, FLOOD_SHARE, Window
from camtopod.records import Event


class Row:
    """An event in the window, and the row of its passage's entry."""

    def __init__(self, t: int, event: Event) -> None:
        self.t = t
        self.event = event
        self.mate: Row | None = None


class PlainWindow:
    """A `Window` by its definition."""

    def __init__(self, events_max: int) -> None:
        self.events_max = events_max
        self.rows: list[Row] = []
        self.open: dict[tuple[str, object], Row] = {}
        self.cameras: list[str] = []

    def append(self, batch: list[tuple[int, Event]]) -> None:
        for t, event in batch:
            row, key = Row(t, event), (event.camera, event.track)
            self.rows.append(row)
            if event.camera not in self.cameras:
                self.cameras.append(event.camera)
            if event.track is not None and event.kind == "entry":
                self.open[key] = row
            elif event.track is not None and key in self.open and self.open[key].t <= t:
                row.mate = self.open.pop(key)
        self.rows.sort(key=lambda row: row.t)

    def _drop(self, gone: list[Row]) -> None:
        self.rows = [row for row in self.rows if row not in gone]
        self.open = {key: row for key, row in self.open.items() if row not in gone}

    def forget_old(self, before: int) -> None:
        self._drop([row for row in self.rows if row.t < before])
        names = [row.event.camera for row in self.rows]
        wild = max(self.cameras, key=names.count, default="")
        while len(self.rows) > self.events_max:
            surplus = [row for row in self.rows if row.event.camera == wild]
            is_flood = len(surplus) > int(FLOOD_SHARE * self.events_max)
            is_flood &= len(self.cameras) >= FLOOD_CAMERAS_MIN
            self._drop([surplus[0] if is_flood else self.rows[0]])

    def forget_camera(self, camera: int, before: int) -> None:
        name = self.cameras[camera]
        self._drop([row for row in self.rows[:before] if row.event.camera == name])

    def forget_cameras(self, names: set[str]) -> None:
        self._drop([row for row in self.rows if row.event.camera in names])
        self.cameras = [name for name in self.cameras if name not in names]


def assert_same(window: Window, plain: PlainWindow) -> None:
    rows = plain.rows
    place = {row: k for k, row in enumerate(rows)}
    names = [row.event.camera for row in rows]
    assert window.column("t").tolist() == [row.t for row in rows]
    assert [window.cameras[k] for k in window.column("camera")] == names
    assert window.column("entry").tolist() == [row.event.kind == "entry" for row in rows]
    assert [max(row, -1) for row in window.entries_of_exits().tolist()] == [
        -1 if row.mate is None else place.get(row.mate, -1) for row in rows
    ]
    for camera, name in enumerate(window.cameras):
        assert window.rows_of_camera(camera).tolist() == [
            k for k, other in enumerate(names) if other == name
        ]
    opened = list(window.state.open.values())
    assert opened == sorted(opened)
    assert {
        (window.cameras[camera], track): row - window.state.base
        for (camera, track), row in window.state.open.items()
    } == {key: place[row] for key, row in plain.open.items()}


NAMES = st.sampled_from("abcd")
TIMED = st.tuples(
    st.integers(0, 60),
    st.builds(
        Event,
        NAMES,
        st.sampled_from(["entry", "exit"]),
        st.just(0.0),
        track=st.sampled_from([None, "1", "2"]),
    ),
)
BATCH = st.lists(TIMED, max_size=10).map(lambda batch: sorted(batch, key=lambda timed: timed[0]))
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("append"), BATCH),
        st.tuples(st.just("forget_old"), st.integers(0, 60)),
        st.tuples(st.just("forget_cameras"), st.sets(NAMES, max_size=2)),
        st.tuples(st.just("forget_camera"), st.tuples(st.integers(0, 3), st.integers(0, 20))),
    ),
    max_size=14,
)


@given(STEPS, st.integers(3, 25))
def test_late_rows_are_sorted_in_with_their_passages(
    steps: list[tuple[str, Any]], events_max: int
) -> None:
    window, plain = Window(events_max), PlainWindow(events_max)
    for name, value in steps:
        values = value if isinstance(value, tuple) else (value,)
        if name == "forget_camera":
            values = (value[0], min(value[1], len(window)))
            if value[0] >= len(window.cameras):
                continue
        for target in (window, plain):
            getattr(target, name)(*values)
        assert_same(window, plain)


def test_an_exit_that_comes_late_ends_no_later_passage() -> None:
    """As of a camera whose clock was set back, or that counts its tracks from 1 again."""
    window = Window(100)
    window.append([(100, Event("a", "entry", 0.0, track="1"))])
    window.append([(40, Event("a", "exit", 0.0, track="1"))])
    window.append([(120, Event("a", "exit", 0.0, track="1"))])
    assert [max(row, -1) for row in window.entries_of_exits().tolist()] == [-1, -1, 1]
