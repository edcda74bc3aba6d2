"""Has a camera been turned? From some event on its events come from other places, and its zones are
silent.

A shift of traffic between known zones is no move, whatever its size; nor is a door that opens, nor
one that closes. So two things are asked of the newest events of a camera, for several lengths of
"newest":

1. *The known zones are silent*: of the shares of the traffic they had, little is left to them.
2. *Other places explain them better.* Against the places known (each zone and the clutter distribute their events as
   they did before; how many fall to each is free, and taken as it suits best) stands a kernel density in which every
   event is foretold by the newest events before it. As it never sees the event it foretells, the likelihood ratio
   exceeds r with a probability of at most 1 / r as long as nothing has changed (Ville's inequality), for each length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.learn.zones import kernel_1d
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

FALSE_ALARM = 1e-9
"""Chance of a likelihood ratio like that in one look at one camera that stands still, if zones were
known exactly.
"""
LENGTHS = (60, 90, 135, 200, 300)
"""Newest events looked at."""
BEFORE_MIN = 100
"""Events before them that tell the known places."""
LEFT_MAX = 0.35
"""At most so much of their shares of the traffic is left to the known zones, chance allowed for
(two standard deviations); what one has gained does not count."""
LEFT_SURE = 0.5
"""With so much left to them by the very newest events there is no need to look further."""
KNOWN_CONTRAST = 2.5
"""A zone is known when it was so many times as dense as the rest of the image; the map may have
newer ones.
"""
_WIDTH = 1.0
_EVENTS_EVEN = 2.0
"""The kernel density begins as an even spread that weighs as much as this many events."""
_ROWS, _COLUMNS = kernel_1d(GRID_ROWS, _WIDTH), kernel_1d(GRID_COLUMNS, _WIDTH)
_ROWS, _COLUMNS = (
    _ROWS / _ROWS.sum(axis=1, keepdims=True),
    _COLUMNS / _COLUMNS.sum(axis=1, keepdims=True),
)
_CELLS = GRID_ROWS * GRID_COLUMNS


class Move(NamedTuple):
    """The events from index ``first`` on come from other places. ``outside``: share of them outside
    the known zones; ``log_ratio``: of their likelihoods; ``left``: how much of its share of the
    traffic the known zones have kept."""

    first: int
    events: int
    outside: float
    log_ratio: float
    left: float


def find_move(cell: NDArray[np.int64], zones: NDArray[np.int16]) -> Move | None:
    """The move of a camera, None if there is none. ``cell``: flat grid cell of its events, oldest
    first; ``zones`` (rows, columns): its map (`ZoneMap.cells`)."""
    best: Move | None = None
    for length in LENGTHS:
        if len(cell) - length < BEFORE_MIN:
            break
        part = _known_zones(np.bincount(cell[:-length], minlength=_CELLS), zones.ravel())
        if not part.any():
            continue
        left = _left(cell[:-length], cell[-length:], part)
        if left + 2 * np.sqrt(left / length) > LEFT_MAX:
            if length == LENGTHS[0] and left > LEFT_SURE:
                return None
            continue
        move = _moved(cell[:-length], cell[-length:], part, left)
        if move and (best is None or move.log_ratio > best.log_ratio):
            best = move
    return best


def _left(before: NDArray[np.int64], newest: NDArray[np.int64], part: NDArray[np.int64]) -> float:
    """How much of its share of the traffic the known zones have kept, place by place."""
    had, has = (
        _smooth(np.bincount(cell, minlength=_CELLS))[part > 0] / len(cell)
        for cell in (before, newest)
    )
    return float(np.minimum(had, has).sum() / had.sum())


def _moved(
    before: NDArray[np.int64], newest: NDArray[np.int64], part: NDArray[np.int64], left: float
) -> Move | None:
    """Whether other places explain ``newest`` better than those of ``before``; ``part``: each
    cell's known zone.
    """
    smooth = _smooth(np.bincount(before, minlength=_CELLS))
    parts = int(part.max()) + 1
    had, has = (np.bincount(part[cell], minlength=parts) / len(cell) for cell in (before, newest))
    within = np.log(smooth / np.bincount(part, smooth, parts)[part])[newest]
    log_ratio = float((_foretold(newest, earlier=True) - within - np.log(has[part[newest]])).sum())
    if log_ratio < -np.log(FALSE_ALARM):
        return None
    change = (
        _foretold(newest, earlier=False)
        - within
        - np.log(np.maximum(had[part[newest]], 1 / len(before)))
    )
    first = int(np.cumsum(change[::-1])[::-1].argmax())
    outside = float((part[newest[first:]] == 0).mean())
    return Move(len(before) + first, len(newest) - first, outside, log_ratio, left)


def _known_zones(count: NDArray[np.int64], zones: NDArray[np.int16]) -> NDArray[np.int64]:
    """The zone of each cell counted from 1, 0 outside; zones that are not denser than the rest are
    outside, too.
    """
    part = zones.astype(np.int64) + 1
    had, size = (
        np.bincount(part, count, part.max() + 1),
        np.bincount(part, minlength=part.max() + 1),
    )
    rest = (had[0] + 1) / max(int(size[0]), 1)
    kept = had > KNOWN_CONTRAST * rest * size
    kept[0] = False
    number = np.cumsum(kept) * kept
    return np.asarray(number[part])


def _smooth(count: NDArray[np.int64]) -> Floats:
    """Counts (cells,) spread over their surroundings; nowhere zero."""
    return np.asarray(
        (_ROWS.T @ (count + 1 / _CELLS).reshape(GRID_ROWS, GRID_COLUMNS) @ _COLUMNS).ravel()
    )


def _foretold(cell: NDArray[np.int64], earlier: bool) -> Floats:
    """Log density of each event in a kernel density over the events before it, or over all
    others.
    """
    row, column = np.divmod(cell, GRID_COLUMNS)
    near = _ROWS[np.ix_(row, row)] * _COLUMNS[np.ix_(column, column)]
    near, seen = (
        (np.tril(near, -1), np.arange(len(cell)))
        if earlier
        else (near - np.diag(near.diagonal()), len(cell) - 1)
    )
    return np.asarray(np.log((near.sum(axis=1) + _EVENTS_EVEN / _CELLS) / (seen + _EVENTS_EVEN)))
