"""Sliding window of event time: the events that are learned from, and integer sums over them.

A `Window` holds events as rows of a table, oldest first, stored by column (`_COLUMNS`). Cameras are
numbered from 0 as their first events are added. Rows are addressed in two ways: by *index*, from 0
for the oldest row of the window, and by *absolute number*, which is the index plus the number of
rows removed so far (``base``) and so stays the same while the window moves. Only `forget_camera`
and `forget_cameras` renumber rows. A passage is stored as one number: the column ``mate`` of an
exit holds the absolute number of the row of its entry.

Positions are integers (fixed point), summed per camera and grid cell. Integer sums can be
subtracted exactly, so a zone's mean and covariance do not depend on events that have left the
window.
"""

from __future__ import annotations

from collections.abc import Set
from itertools import takewhile
from operator import itemgetter
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.arrays import rows_by_group
from camtopod.learn.zones import CellSums, GridSums
from camtopod.records import Event
from camtopod.topology import GRID_COLUMNS, GRID_ROWS, POSITION_ONE

OPEN_PASSAGES_MAX = 100_000
"""Entries of all cameras that wait for the exit of their track; beyond, the oldest is forgotten."""
FLOOD_SHARE = 0.75
FLOOD_CAMERAS_MIN = 3
"""Share of a full window above which one camera's events flood it, and the least number of cameras
of a site for which this is checked.
"""
NO_CELL = -1
"""Coordinate and cell of events without position."""
NO_MATE = -1
"""Value of ``mate`` for entries, and for exits of unknown entry."""
FORGOTTEN = -1
"""New index of a forgotten camera in the result of `Window.forget_cameras`."""

_COLUMNS = {
    "t": np.int64,
    "camera": np.int32,
    "entry": np.bool_,
    "px": np.int32,
    "py": np.int32,
    "mate": np.int64,
}
"""Columns of the window: time in microseconds; index of the camera; True for an entry, False for an
exit; position (x, y) in fixed point, `NO_CELL` if unknown; absolute row of an exit's entry, or
`NO_MATE`.
"""


class WindowState(Struct):
    """The saved state of a `Window`; its sums are computed from the rows again.

    base, cameras, seen, columns: as in `Window`.
    open: (camera, track, absolute row of the entry) of passages that have not ended.
    """

    base: int = 0
    cameras: list[str] = []
    seen: list[int] = []
    open: list[tuple[int, str, int]] = []
    columns: dict[str, NDArray[Any]] = {}


class Window:
    """The events that are learned from, by column, and sums over them by camera and grid cell.

    The window holds ``events`` events, or ``camera_events`` for each camera if that is more, but
    never more than ``events_max``. With ``events`` None it holds ``events_max``.
    """

    def __init__(self, events_max: int, events: int | None = None, camera_events: int = 0) -> None:
        self._events_max = events_max
        self._camera_events = camera_events
        self._events = events_max if events is None else events
        self.cameras: list[str] = []
        self.base = 0
        """Absolute number of the first row."""
        self.sums = GridSums()
        self.unplaced: list[NDArray[np.int64]] = []
        """For each camera the numbers (2,) of entries and of exits without position in the window.
        """
        self.seen: list[int] = []
        """Number of positioned events of each camera that have ever been added."""
        self._index: dict[str, int] = {}
        # Absolute row of the entry of each passage that has not ended, by (camera, track).
        # Ascending by row; all rows are in the window.
        self._open: dict[tuple[int, str], int] = {}
        self._columns: dict[str, NDArray[Any]] = {
            name: np.zeros(1024, dtype) for name, dtype in _COLUMNS.items()
        }
        # The rows of the window within the columns.
        self._start = 0
        self._stop = 0

    def __len__(self) -> int:
        return self._stop - self._start

    @property
    def events_max(self) -> int:
        """Size of the window in events."""
        return min(self._events_max, max(self._events, self._camera_events * len(self.cameras)))

    def save(self) -> WindowState:
        """Return the state from which `load` continues."""
        passages = [(camera, track, row) for (camera, track), row in self._open.items()]
        columns = {name: self.column(name).copy() for name in _COLUMNS}
        return WindowState(self.base, list(self.cameras), list(self.seen), passages, columns)

    def load(self, state: WindowState) -> None:
        """Continue from a saved state; this window must be new."""
        for name in state.cameras:
            self._camera(name)
        self.base = state.base
        by_row = sorted(state.open, key=itemgetter(2))
        self._open = {(camera, track): row for camera, track, row in by_row if row >= self.base}
        self._columns = dict(state.columns)
        self._start, self._stop = 0, len(state.columns["t"])
        self._update_sums(slice(0, self._stop), 1)
        self.seen = list(state.seen)

    def column(self, name: str) -> NDArray[Any]:
        """Return one of the `_COLUMNS` (n,), oldest row first, as a view not to be written to."""
        return self._columns[name][self._start : self._stop]

    def camera_index(self, camera: str) -> int | None:
        """Return the index of a camera, or None if none of its events was added."""
        return self._index.get(camera)

    def append(self, batch: list[tuple[int, Event]]) -> None:
        """Add events (microseconds, event) in order of time, none older than the newest row."""
        # Compute the columns of the new rows.
        n = len(batch)
        self._make_room(n)
        rows = slice(self._stop, self._stop + n)
        camera = [self._camera(event.camera) for _, event in batch]
        first = self.base + len(self)
        fresh: dict[str, list[Any]] = {
            "t": [t_us for t_us, _ in batch],
            "camera": camera,
            "entry": [event.kind == "entry" for _, event in batch],
            "px": [_fixed_point(event.x, event.y) for _, event in batch],
            "py": [_fixed_point(event.y, event.x) for _, event in batch],
            "mate": [self._mate(camera[k], event, first + k) for k, (_, event) in enumerate(batch)],
        }

        # Store them.
        for name, values in fresh.items():
            self._columns[name][rows] = values
        self._stop += n
        self._update_sums(rows, 1)

    def forget_old(self, before_us: int) -> int:
        """Remove events older than ``before_us`` or beyond the window's size; return their number.

        If one camera floods the window (`FLOOD_SHARE`), its oldest events are removed before those
        of other cameras.
        """
        old = int(np.searchsorted(self.column("t"), before_us))
        self._forget_oldest(old)
        beyond = max(len(self) - self.events_max, 0)
        self._forget_oldest(beyond - self._forget_flood(beyond))
        return old + beyond

    def _forget_oldest(self, drop: int) -> None:
        """Remove the oldest ``drop`` rows, and open passages that began in them."""
        if drop > 0:
            self._update_sums(slice(self._start, self._start + drop), -1)
            self._start += drop
            self.base += drop
            gone = [
                key
                for key, _ in takewhile(lambda passage: passage[1] < self.base, self._open.items())
            ]
            for key in gone:
                del self._open[key]

    def _forget_flood(self, most: int) -> int:
        """Remove up to ``most`` of the oldest rows of a flooding camera; return their number."""
        if most == 0 or len(self.cameras) < FLOOD_CAMERAS_MIN:
            return 0
        count = np.bincount(self.column("camera"))
        camera = int(count.argmax())
        allowed = int(FLOOD_SHARE * self.events_max)
        surplus = min(most, int(count[camera]) - allowed)
        if surplus <= 0:
            return 0
        rows = np.flatnonzero(self.column("camera") == camera)
        return self.forget_camera(camera, self.base + int(rows[surplus - 1]) + 1)

    def forget_camera(self, camera: int, before: int) -> int:
        """Remove the camera's rows before the absolute row ``before``; return their number.

        The remaining rows get new absolute numbers.
        """
        gone = np.zeros(len(self), np.bool_)
        gone[: max(before - self.base, 0)] = True
        gone &= self.column("camera") == camera
        return self._drop(gone)

    def forget_cameras(self, names: Set[str]) -> NDArray[np.int64]:
        """Forget cameras and their events, and renumber the other cameras.

        Return the new index of each camera, by old index; `FORGOTTEN` for the forgotten ones.
        """
        # Remove the events.
        kept = np.array([name not in names for name in self.cameras], np.bool_)
        number = np.where(kept, np.cumsum(kept) - 1, FORGOTTEN)
        gone = ~kept[self.column("camera")]
        if gone.any():
            self._drop(gone)

        # Renumber the cameras of the other events.
        rows = slice(self._start, self._stop)
        self._columns["camera"][rows] = number[self._columns["camera"][rows]]
        self._open = {
            (int(number[camera]), track): row for (camera, track), row in self._open.items()
        }

        # Remove the cameras.
        others = np.flatnonzero(kept).tolist()
        self.sums.keep(others)
        self.unplaced = [self.unplaced[camera] for camera in others]
        self.seen = [self.seen[camera] for camera in others]
        self.cameras = [self.cameras[camera] for camera in others]
        self._index = {name: camera for camera, name in enumerate(self.cameras)}
        return number

    def _drop(self, gone: NDArray[np.bool_]) -> int:
        """Remove the rows of the mask ``gone`` (n,), of any age; return the number of rows."""
        drop = int(gone.sum())
        self._update_sums(np.flatnonzero(gone) + self._start, -1)

        # Renumber passages: absolute row of each remaining row after the removal.
        number = np.where(gone, NO_MATE, self.base + drop + np.cumsum(~gone) - 1)
        mate = self.column("mate")
        renumbered = np.where(mate >= self.base, number[np.maximum(mate - self.base, 0)], mate)
        self._columns["mate"][self._start : self._stop] = renumbered
        self._open = {
            key: int(number[row - self.base])
            for key, row in self._open.items()
            if not gone[row - self.base]
        }

        # Move the remaining rows together, to the end.
        for column in self._columns.values():
            column[self._start + drop : self._stop] = column[self._start : self._stop][~gone]
        self._start += drop
        self.base += drop
        return drop

    def cell_sums(self, camera: int) -> CellSums:
        """Return the sums over one camera's positioned events, by cell of the grid."""
        return CellSums(*self.sums[camera][:6])

    def rows_of_cameras(self) -> list[NDArray[np.intp]]:
        """Return the row indices of each camera, oldest first; valid until the window changes."""
        return rows_by_group(self.column("camera"), len(self.cameras))

    def events_of_cameras(self) -> NDArray[np.int64]:
        """Return the number of events of each camera in the window (cameras,)."""
        return np.bincount(self.column("camera"), minlength=len(self.cameras))

    def count_with_position(self, camera: int) -> int:
        """Return the number of the camera's events in the window that have positions."""
        return self.sums.count(camera)

    def _camera(self, name: str) -> int:
        """Return the index of a camera, which is added if it is new."""
        index = self._index.get(name)
        if index is None:
            index = self._index[name] = len(self.cameras)
            self.cameras.append(name)
            self.sums.append()
            self.unplaced.append(np.zeros(2, np.int64))
            self.seen.append(0)
        return index

    def _mate(self, camera: int, event: Event, row: int) -> int:
        """Return the value of ``mate`` for a new event; remember entries that have a track.

        row: absolute number of the event's row.
        """
        if event.track is None:
            return NO_MATE
        key = (camera, str(event.track))
        mate = self._open.pop(key, NO_MATE)
        if event.kind == "exit":
            return mate
        self._open[key] = row
        if len(self._open) > OPEN_PASSAGES_MAX:
            del self._open[next(iter(self._open))]
        return NO_MATE

    def _update_sums(self, rows: slice | NDArray[np.intp], sign: int) -> None:
        """Add rows to the sums of their cameras (``sign`` +1) or subtract them (-1).

        rows: rows of the columns as stored, counted from the beginning of the arrays.
        """
        # Find the cell of each event, and the events of each camera.
        camera = self._columns["camera"][rows]
        entry = self._columns["entry"][rows]
        px, py = (self._columns[name][rows].astype(np.int64) for name in ("px", "py"))
        cell = cells_of(px, py)
        order = np.argsort(camera, kind="stable")
        present, first = np.unique(camera[order], return_index=True)

        for index, events in zip(present.tolist(), np.split(order, first)[1:], strict=True):
            # Events with positions count by cell.
            placed = events[cell[events] >= 0]
            at = cell[placed]
            x = px[placed]
            y = py[placed]
            if len(at):
                values = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y, entry[placed]))
                self.sums.add(index, at, sign * values)
            self.seen[index] += len(at) if sign > 0 else 0

            # Events without position count as entries or exits of their camera.
            entries = int(entry[events].sum()) - int(entry[placed].sum())
            self.unplaced[index] += sign * np.array([entries, len(events) - len(placed) - entries])

    def _make_room(self, n: int) -> None:
        """Make room for ``n`` more rows at the end, in larger columns if needed."""
        size = len(self._columns["t"])
        if self._stop + n <= size:
            return
        kept = len(self)
        new_size = max(1024, 2 * (kept + n))
        for name, old in self._columns.items():
            fresh = np.zeros(new_size, old.dtype)
            fresh[:kept] = old[self._start : self._stop]
            self._columns[name] = fresh
        self._start = 0
        self._stop = kept


def _fixed_point(value: float | None, other: float | None) -> int:
    """Return the coordinate ``value`` in fixed point; `NO_CELL` if it or the other is missing."""
    return NO_CELL if value is None or other is None else round(value * POSITION_ONE)


def cells_of(px: NDArray[np.int64], py: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the flat grid cell (n,), row * columns + column, of positions; `NO_CELL` for none.

    px, py (n,): positions in fixed point (`POSITION_ONE`), `NO_CELL` if unknown.
    """
    column = np.minimum(px * GRID_COLUMNS // POSITION_ONE, GRID_COLUMNS - 1)
    row = np.minimum(py * GRID_ROWS // POSITION_ONE, GRID_ROWS - 1)
    return np.where(px < 0, NO_CELL, row * GRID_COLUMNS + column)
