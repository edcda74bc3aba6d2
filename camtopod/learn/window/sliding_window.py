"""Sliding window of event time: the events that are learned from.

A `Window` holds events as rows of a table, oldest first, stored by column (`_COLUMNS`). Cameras are
numbered from 0 as their first events are added. Rows are addressed by *index*, from 0 for the
oldest row of the window. A passage is stored as one number: the column ``mate`` of an exit holds
the *absolute number* of the row of its entry, which is the index plus the number of rows removed so
far (``base``) and so stays the same while the window moves. Only late events, `forget_camera` and
`forget_cameras` renumber rows.

Positions are integers (fixed point), so that sums of them are exact in any order.
"""

from __future__ import annotations

import sys
from array import array
from bisect import bisect_left
from collections.abc import Set
from itertools import takewhile
from typing import Any

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from camtopod.arrays import rows_by_group
from camtopod.labels import LABELS_MAX, plain
from camtopod.records import Event
from camtopod.topology import POSITION_ONE

OPEN_PASSAGES_MAX = 100_000
"""Entries of all cameras that wait for the exit of their track; beyond, the oldest is forgotten."""
FLOOD_SHARE = 0.75
FLOOD_CAMERAS_MIN = 3
"""Share of a full window above which one camera's events flood it, and the least number of cameras
of a site for which this is checked.
"""
NONE = -1
"""Value in a column of events that have none: no position, no label, as ``mate`` no entry that is
known; and new index of a forgotten camera.
"""
LABELS_REMEMBERED = 4 * LABELS_MAX
"""Number of labels from which those without events in the window are forgotten."""

_COLUMNS = {
    "t": np.int64,
    "camera": np.int32,
    "entry": np.bool_,
    "px": np.int32,
    "py": np.int32,
    "mate": np.int64,
    "label": np.int32,
}
"""Columns of the window: time in microseconds; index of the camera; True for an entry, False for an
exit; position (x, y) in fixed point, `NONE` if unknown; absolute row of an exit's entry, or
`NONE`; index of the label, or `NONE`.
"""


class WindowState(Struct):
    """The state of a `Window`."""

    base: int = 0
    """Absolute number of the first row."""
    cameras: list[str] = []
    """Names of the cameras."""
    seen: list[int] = []
    """Number of positioned events of each camera that have ever been added."""
    open: dict[tuple[int, str], int] = {}
    """Absolute row of the entry of each passage that has not ended, by (camera, track).

    Ascending by row; all rows are in the window.
    """
    labels: list[str] = []
    """Labels, in the order in which they came."""
    columns: dict[str, NDArray[Any]] = field(
        default_factory=lambda: {name: np.zeros(0, dtype) for name, dtype in _COLUMNS.items()}
    )


class Window:
    """The events that are learned from, by column.

    The window holds ``events`` events, or ``camera_events`` for each camera if that is more, but
    never more than ``events_max``.

    state: state to continue from; None for an empty window.
    """

    def __init__(
        self,
        events: int,
        camera_events: int = 0,
        events_max: int = sys.maxsize,
        state: WindowState | None = None,
    ) -> None:
        self._events = events
        self._camera_events = camera_events
        self._events_max = events_max
        self.state = state or WindowState()
        self._index = {name: camera for camera, name in enumerate(self.state.cameras)}
        self._label_index = {label: k for k, label in enumerate(self.state.labels)}
        self._memory: dict[str, NDArray[Any]] = {}
        """The columns, with rows removed before them and room behind them."""
        self._end = 0
        """Where the columns end in ``_memory``."""
        self._rows: list[array[int]] = []
        """Absolute rows of each camera, oldest first."""
        self._hold(self.state.columns)

    def __len__(self) -> int:
        return len(self.state.columns["t"])

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras."""
        return self.state.cameras

    @property
    def seen(self) -> list[int]:
        """As in `WindowState.seen`."""
        return self.state.seen

    @property
    def events_max(self) -> int:
        """Size of the window in events."""
        return min(self._events_max, max(self._events, self._camera_events * len(self.cameras)))

    def column(self, name: str) -> NDArray[Any]:
        """Return one of the `_COLUMNS` (n,), oldest row first, not to be written to."""
        return self.state.columns[name]

    def entries_of_exits(self) -> NDArray[np.int64]:
        """Return the row of the entry of each exit (n,), negative where there is none."""
        row: NDArray[np.int64] = self.column("mate") - self.state.base
        return row

    def append(self, batch: list[tuple[int, Event]]) -> None:
        """Add events (microseconds, event) in order of time; late ones are sorted in.

        Passages join the events of a camera in the order in which they are added, an exit only
        with an entry that is not later.
        """
        size = len(self)
        before = int(np.searchsorted(self.column("t"), batch[0][0], "right")) if batch else size

        # Make room, for a quarter more than there are.
        if self._end + len(batch) > len(self._memory["t"]):
            self._hold(self.state.columns, len(self) // 4 + len(batch))

        # Compute the columns of the new rows.
        camera = [self._camera(event.camera) for _, event in batch]
        first = self.state.base + len(self)
        fresh: dict[str, list[Any]] = {
            "t": [t_us for t_us, _ in batch],
            "camera": camera,
            "entry": [event.kind == "entry" for _, event in batch],
            "px": [_fixed_point(event.x, event.y) for _, event in batch],
            "py": [_fixed_point(event.y, event.x) for _, event in batch],
            "mate": [self._mate(camera[k], batch[k], first + k) for k in range(len(batch))],
            "label": [self._label(event.label) for _, event in batch],
        }
        for row, (index, px) in enumerate(zip(camera, fresh["px"], strict=True), first):
            self.seen[index] += px != NONE
            self._rows[index].append(row)

        # Store them in the memory behind the other rows.
        end = self._end + len(batch)
        size += len(batch)
        for name, memory in self._memory.items():
            memory[self._end : end] = fresh[name]
            self.state.columns[name] = memory[end - size : end]
        self._end = end
        if before < size - len(batch):
            self._sort(before)

    def without_repeats(self, batch: list[tuple[int, Event]]) -> list[tuple[int, Event]]:
        """Return events (microseconds, event) but those that were added before.

        An event with a number or without a position is none of these.
        """
        return [item for item in batch if item[1].seq is not None or not self._holds(*item)]

    def _holds(self, t_us: int, event: Event) -> bool:
        """Return True if a row has the time, camera, kind and position of an event."""
        if event.x is None or event.y is None:
            return False
        rows = slice(*np.searchsorted(self.column("t"), (t_us, t_us + 1)).tolist())
        place = _fixed_point(event.x, event.y), _fixed_point(event.y, event.x)
        columns = [self.column(name)[rows].tolist() for name in ("camera", "entry", "px", "py")]
        row = self._index.get(event.camera, NONE), event.kind == "entry", *place
        return row in zip(*columns, strict=True)

    def _sort(self, first: int) -> None:
        """Sort the rows from ``first`` on by time; rows at the same time stay in their order."""
        base, size = self.state.base, len(self)
        order = first + np.argsort(self.column("t")[first:], kind="stable")
        number = np.arange(size)
        number[order] = number[first:].copy()
        self._renumber(base + number, first)
        for name, memory in self._memory.items():
            rows = memory[self._end - size : self._end]
            rows[first:] = self.column(name)[order]
            self.state.columns[name] = rows
        for of_camera in self._rows:
            del of_camera[bisect_left(of_camera, base + first) :]
        for row, camera in enumerate(self.column("camera")[first:].tolist(), base + first):
            self._rows[camera].append(row)

    def _renumber(self, number: NDArray[np.int64], first: int = 0) -> None:
        """Give the rows new absolute numbers (n,) where passages name them; `NONE` for none.

        first: rows before this one keep their numbers.
        """
        base = self.state.base
        row = self.entries_of_exits()
        mate = np.where(row >= 0, number[np.maximum(row, 0)], self.column("mate"))
        self.state.columns = {**self.state.columns, "mate": mate}
        passages, moves = self.state.open, []
        while passages and passages[last := next(reversed(passages))] >= base + first:
            moves.append((int(number[passages.pop(last) - base]), last))
        passages.update((key, row) for row, key in sorted(moves) if row != NONE)

    def forget_old(self, before_us: int) -> int:
        """Remove events older than ``before_us`` or beyond the window's size; return their number.

        If one camera floods the window (`FLOOD_SHARE`), its oldest events are removed before those
        of other cameras.
        """
        old = int(np.searchsorted(self.column("t"), before_us))
        self._forget_oldest(old)
        beyond = max(len(self) - self.events_max, 0)
        self._forget_oldest(beyond - self._forget_flood(beyond))
        if len(self.state.labels) > LABELS_REMEMBERED:
            self._forget_labels()
        return old + beyond

    def _forget_labels(self) -> None:
        """Forget the labels without events in the window."""
        column = self.column("label")
        labels = np.unique(column[column != NONE])
        number = np.append(np.zeros(len(self.state.labels), np.int32), NONE).astype(np.int32)
        number[labels] = np.arange(len(labels))
        self.state.labels = [self.state.labels[k] for k in labels.tolist()]
        self._label_index = {label: k for k, label in enumerate(self.state.labels)}
        self._hold({**self.state.columns, "label": number[column]})

    def _forget_oldest(self, drop: int) -> None:
        """Remove the oldest ``drop`` rows, and open passages that began in them."""
        state = self.state
        for camera, rows in enumerate(np.bincount(self.column("camera")[:drop]).tolist()):
            del self._rows[camera][:rows]
        state.columns = {name: column[drop:] for name, column in state.columns.items()}
        state.base += drop
        keys = list(takewhile(lambda key: state.open[key] < state.base, state.open))
        for key in keys:
            del state.open[key]

    def _forget_flood(self, limit: int) -> int:
        """Remove up to ``limit`` of the oldest rows of a flooding camera; return their number."""
        if limit == 0 or len(self.cameras) < FLOOD_CAMERAS_MIN:
            return 0
        count = self.events_of_cameras()
        camera = int(count.argmax())
        quota = int(FLOOD_SHARE * self.events_max)
        surplus = min(limit, int(count[camera]) - quota)
        if surplus <= 0:
            return 0
        rows = np.flatnonzero(self.column("camera") == camera)
        self.forget_camera(camera, int(rows[surplus - 1]) + 1)
        return surplus

    def forget_camera(self, camera: int, before: int) -> None:
        """Remove the camera's rows before the row ``before``."""
        mask = self.column("camera") == camera
        mask[before:] = False
        self._drop(mask)

    def forget_cameras(self, names: Set[str]) -> NDArray[np.int64]:
        """Forget cameras and their events, and renumber the other cameras.

        Return the new index of each camera, by old index; `NONE` for the forgotten ones.
        """
        # Remove the events.
        state = self.state
        is_kept = np.array([name not in names for name in self.cameras], np.bool_)
        number = np.where(is_kept, np.cumsum(is_kept) - 1, NONE)
        self._drop(~is_kept[self.column("camera")])

        # Renumber the cameras of the other events.
        camera_column = number[state.columns["camera"]].astype(_COLUMNS["camera"])
        state.open = {
            (int(number[camera]), track): row for (camera, track), row in state.open.items()
        }

        # Remove the cameras.
        indices = np.flatnonzero(is_kept).tolist()
        state.seen = [self.seen[camera] for camera in indices]
        state.cameras = [self.cameras[camera] for camera in indices]
        self._index = {name: camera for camera, name in enumerate(self.cameras)}
        self._hold({**state.columns, "camera": camera_column})
        return number

    def _drop(self, mask: NDArray[np.bool_]) -> None:
        """Remove the rows of the ``mask`` (n,), of any age; the others get new numbers."""
        if not mask.any():
            return
        state = self.state
        base = state.base + int(mask.sum())

        # The absolute row of each remaining row after the removal.
        self._renumber(np.where(mask, NONE, base + np.cumsum(~mask) - 1))
        state.base = base
        self._hold({name: column[~mask] for name, column in state.columns.items()})

    def _hold(self, columns: dict[str, NDArray[Any]], room: int = 0) -> None:
        """Store columns, with unused memory for ``room`` more rows behind them."""
        self.state.columns = columns
        self._end = len(self)
        self._memory = {
            name: np.concatenate((column, np.empty(room, column.dtype)))
            for name, column in columns.items()
        }
        groups = rows_by_group(columns["camera"], len(self.cameras))
        self._rows = [array("q", (rows + self.state.base).tolist()) for rows in groups]

    def rows_of_camera(self, camera: int) -> NDArray[np.int64]:
        """Return the row indices of a camera, oldest first; valid until the window changes."""
        return np.array(self._rows[camera], np.int64) - self.state.base

    def rows_of_cameras(self) -> list[NDArray[np.int64]]:
        """Return `rows_of_camera` of each camera."""
        return [self.rows_of_camera(camera) for camera in range(len(self.cameras))]

    def events_of_cameras(self) -> NDArray[np.int64]:
        """Return the number of events of each camera in the window (cameras,)."""
        return np.array([len(rows) for rows in self._rows], np.int64)

    def has_position(self) -> NDArray[np.bool_]:
        """Return a mask (n,) of the rows that have a position."""
        mask: NDArray[np.bool_] = self.column("px") != NONE
        return mask

    def labels(self) -> tuple[list[str], NDArray[np.int32]]:
        """Return the `LABELS_MAX` most frequent labels, sorted, and that of each row (n,).

        The second result is an index into the first, or `NONE`. An exit without a label has its
        entry's. Of labels as frequent as each other, the first by name count.
        """
        label = self.column("label")
        entry = self.entries_of_exits()
        label = np.where((label == NONE) & (entry >= 0), label[np.maximum(entry, 0)], label)
        names = self.state.labels
        events = np.bincount(label[label != NONE], minlength=len(names)).tolist()
        frequent = sorted((-number, names[k], k) for k, number in enumerate(events) if number)
        ranking = sorted((name, k) for _, name, k in frequent[:LABELS_MAX])
        number = np.full(len(names) + 1, NONE, np.int32)
        number[[k for _, k in ranking]] = np.arange(len(ranking))
        return [name for name, _ in ranking], number[label]

    @property
    def labels_left_out(self) -> int:
        """Number of the labels that do not count, at most `LABELS_REMEMBERED` or so."""
        return max(len(self.state.labels) - LABELS_MAX, 0)

    def _label(self, label: str | None) -> int:
        """Return the index of a label, which is added if it is new."""
        name = plain(label or "")
        if not name:
            return NONE
        if name not in self._label_index:
            self._label_index[name] = len(self.state.labels)
            self.state.labels.append(name)
        return self._label_index[name]

    def _camera(self, name: str) -> int:
        """Return the index of a camera, which is added if it is new."""
        if name not in self._index:
            self._index[name] = len(self.cameras)
            self.cameras.append(name)
            self.seen.append(0)
            self._rows.append(array("q"))
        return self._index[name]

    def _mate(self, camera: int, item: tuple[int, Event], row: int) -> int:
        """Return the value of ``mate`` for a new event; remember entries that have a track.

        item: (microseconds, event).
        row: absolute number of the event's row.
        """
        t_us, event = item
        if event.track is None:
            return NONE
        open_passages = self.state.open
        key = (camera, str(event.track))
        mate = open_passages.get(key, NONE)
        if event.kind == "exit":
            place = mate - self.state.base
            if 0 <= place < len(self) and self.column("t")[place] > t_us:  # it began later
                return NONE
            return open_passages.pop(key, NONE)
        open_passages.pop(key, None)
        open_passages[key] = row
        if len(open_passages) > OPEN_PASSAGES_MAX:
            del open_passages[next(iter(open_passages))]
        return NONE


def _fixed_point(value: float | None, partner: float | None) -> int:
    """Return ``value`` in fixed point; `NONE` if it or ``partner`` is missing."""
    return NONE if value is None or partner is None else round(value * POSITION_ONE)
