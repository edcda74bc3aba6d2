"""Find turned cameras: their newest events come from new places, and their known zones are silent.

`find_moves` compares the newest n events of a camera, by grid cell, with its earlier events, for
several n (`LENGTHS`). Two conditions must hold:

* *The known zones are silent*: they have kept little of their share of the traffic.
* *Other places explain the newest events better* than the known zones with any proportions between
  them: a kernel density predicts each of the newest events from those before it. If nothing has
  changed, the likelihood ratio exceeds r with a probability of at most 1 / r (Ville's inequality).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Longs
from camtopod.learn.zones import BANDWIDTH_MIN, CELLS, CONTRAST_MIN, kernel_1d
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

FALSE_ALARM = 1e-9
"""Probability of a false move or a false repetition in one test of one camera."""
LENGTHS = (60, 90, 135, 200, 300)
"""Numbers of newest events that are tested."""
BEFORE_MIN = 100
"""Least number of events before the newest ones, from which the known places are learned."""
LEFT_MAX = 0.35
"""Largest share of their traffic that the known zones of a turned camera may have kept. Two
standard deviations are added to the estimate of the share before it is compared. Cells whose
traffic has increased count as unchanged.
"""
_EVENTS_EVEN = 2.0
"""Weight, in events, of a uniform density in the kernel density."""
_ROWS, _COLUMNS = (
    kernel / kernel.sum(axis=1, keepdims=True)
    for kernel in (kernel_1d(size, BANDWIDTH_MIN) for size in (GRID_ROWS, GRID_COLUMNS))
)


class Move(NamedTuple):
    """The move of a camera: when it was turned, and how clearly its events show that."""

    first: int
    """Index of the first of the camera's events after the move."""
    events: int
    """Number of events after the move."""
    outside: float
    """Share of the events after the move that are outside the known zones."""
    log_ratio: float
    """Log likelihood ratio of a move over the known places, nats."""
    stay_share: float
    """Share of their traffic that the known zones have kept."""


def find_moves(cells: Sequence[Indices], zones: Sequence[NDArray[np.int16]]) -> list[Move | None]:
    """Return the move of each of some cameras; None if there is none.

    cells (n,): flat grid cell of each of a camera's events, oldest first.
    zones (rows, columns): the zone of each cell (`ZoneMap.cells`).
    """
    best: list[Move | None] = [None] * len(cells)
    camera_rows = list(range(len(cells)))
    for length in LENGTHS:
        camera_rows = [k for k in camera_rows if len(cells[k]) - length >= BEFORE_MIN]
        if not camera_rows:
            break

        # Condition 1: the known zones are silent.
        before, newest = (
            np.array([np.bincount(cells[k][part], minlength=CELLS) for k in camera_rows])
            for part in (slice(-length), slice(-length, None))
        )
        part = _known_zones(before, np.array([zones[k].ravel() for k in camera_rows]))
        stay_share = _kept(before, newest, part)
        silent = stay_share + 2 * np.sqrt(stay_share / length) <= LEFT_MAX

        # Condition 2: other places explain the events better.
        for row in np.flatnonzero(silent).tolist():
            cell = cells[camera_rows[row]]
            move = _moved(cell[:-length], cell[-length:], part[row], float(stay_share[row]))
            best_move = best[camera_rows[row]]
            if move and (best_move is None or move.log_ratio > best_move.log_ratio):
                best[camera_rows[row]] = move
        camera_rows = [
            k
            for k, goes_on in zip(camera_rows, silent | np.isnan(stay_share), strict=True)
            if goes_on
        ]
    return best


def _kept(before: Longs, newest: Longs, part: Longs) -> Floats:
    """Return the share of their traffic that the known zones have kept, compared cell by cell.

    before, newest (cameras, cells): number of earlier and of newest events in each cell.
    part (cameras, cells): known zone of each cell, from 1; 0 outside.

    The result (cameras,) is NaN without known zones.
    """
    share_before, share_now = (
        _smooth(count) / count.sum(axis=1, keepdims=True) for count in (before, newest)
    )
    share_before *= part > 0
    share_of_zones = share_before.sum(axis=1)
    common_share = np.minimum(share_before, share_now).sum(axis=1)
    return np.asarray(
        np.divide(
            common_share,
            share_of_zones,
            out=np.full(len(share_of_zones), np.nan),
            where=share_of_zones > 0,
        )
    )


def _moved(before: Indices, newest: Indices, part: Longs, stay_share: float) -> Move | None:
    """Return the move if other places explain the newest events better than the known ones.

    before, newest (n,), (m,): flat grid cells of the earlier and the newest events.
    part (cells,): known zone of each cell, from 1; 0 outside.
    stay_share: share of their traffic that the known zones have kept.
    """
    # Log likelihood ratio of the kernel density over the known places.
    smooth = _smooth(np.bincount(before, minlength=CELLS)[None])[0]
    parts = int(part.max()) + 1
    share_before, share_now = (
        np.bincount(part[cell], minlength=parts) / len(cell) for cell in (before, newest)
    )
    within = np.log(smooth / np.bincount(part, smooth, parts)[part])[newest]
    log_ratio = float(
        (_foretold(newest, earlier=True) - within - np.log(share_now[part[newest]])).sum()
    )
    if log_ratio < -np.log(FALSE_ALARM):
        return None

    # The move begins at the event from which on the events speak most for other places.
    change = (
        _foretold(newest, earlier=False)
        - within
        - np.log(np.maximum(share_before[part[newest]], 1 / len(before)))
    )
    first = int(np.cumsum(change[::-1])[::-1].argmax())
    outside = float((part[newest[first:]] == 0).mean())
    return Move(len(before) + first, len(newest) - first, outside, log_ratio, stay_share)


def _known_zones(count: Longs, zones: NDArray[np.int16]) -> Longs:
    """Return the known zone of each cell (cameras, cells), counted from 1; 0 for all other cells.

    count (cameras, cells): number of earlier events in each cell.
    zones (cameras, cells): zone of each cell in the map; -1 outside all zones.

    A zone is known if before the newest events, which may have made a zone of the map, it was as
    much denser than the cells outside all zones as a zone has to be (`CONTRAST_MIN`).
    The known zones are numbered anew, without gaps: their numbers are not those of the map.
    """
    cameras = len(count)
    parts = int(zones.max()) + 2
    part = zones + 1 + parts * np.arange(cameras)[:, None]
    events, size = (
        np.bincount(part.ravel(), weight, cameras * parts).reshape(cameras, parts)
        for weight in (count.ravel(), None)
    )
    outside = (events[:, :1] + 1) / np.maximum(size[:, :1], 1)
    is_known = events > CONTRAST_MIN * outside * size
    is_known[:, 0] = False
    number = np.cumsum(is_known, axis=1) * is_known
    return np.asarray(number.ravel()[part])


def _smooth(count: Longs) -> Floats:
    """Return event counts (cameras, cells) smoothed over the grid; no count is zero."""
    grids = (count + 1 / CELLS).reshape(-1, GRID_ROWS, GRID_COLUMNS)
    return np.asarray((_ROWS.T @ grids @ _COLUMNS).reshape(count.shape))


def _foretold(cell: Indices, earlier: bool) -> Floats:
    """Return the log density (n,) of each of n events under a kernel density of the others.

    cell (n,): flat grid cell of each event.
    earlier: True to use only the events before an event for its density.
    """
    row, column = np.divmod(cell, GRID_COLUMNS)
    near = _ROWS[np.ix_(row, row)] * _COLUMNS[np.ix_(column, column)]
    events = np.full(len(cell), len(cell) - 1)
    np.fill_diagonal(near, 0.0)
    if earlier:
        near = np.tril(near, -1)
        events = np.arange(len(cell))
    return np.asarray(np.log((near.sum(axis=1) + _EVENTS_EVEN / CELLS) / (events + _EVENTS_EVEN)))
