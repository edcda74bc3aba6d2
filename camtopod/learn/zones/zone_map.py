"""Entry/exit zones of one camera from the sums over its grid (thesis sections 2.4, 2.8, 4.2).

The learner keeps integer sums per grid cell, so taking an old event out of the window is exact, and
a refresh costs the same for a hundred events as for ten million. `partition` finds the groups of
cells; here they become zones: exact statistics, a number that stays with the place, and a table
that says which cell belongs to which zone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from camtopod.arrays import Floats, Longs
from camtopod.learn.limits import ZONES_PER_CAMERA_MAX
from camtopod.learn.zones.clutter import clutter_rates
from camtopod.learn.zones.mixture import classify_cells
from camtopod.learn.zones.partition import Cells, partition
from camtopod.topology import GRID_COLUMNS, GRID_ROWS, POSITION_ONE

ANEW_EVENTS_MAX = 4000
"""With so many events zones are no longer learned from nothing."""
CELLS = GRID_ROWS * GRID_COLUMNS
MATCH_DISTANCE = 3.0
"""A zone is at an old zone's place when its centre is within this many standard deviations of
it.
"""
PLACE_SD_MIN = 0.02
"""Image units: a zone narrower than this is as broad as this for matching."""
_SCALE = np.array(
    [1, POSITION_ONE, POSITION_ONE, POSITION_ONE**2, POSITION_ONE**2, POSITION_ONE**2]
)[:, None]


class CellSums(NamedTuple):
    """Sums over the events of each cell, int64, shape (GRID_ROWS, GRID_COLUMNS); positions in fixed
    point.
    """

    count: Longs  # type: ignore[assignment]  # hides a method of tuple nobody needs
    sx: Longs
    sy: Longs
    sxx: Longs
    sxy: Longs
    syy: Longs


class ZoneShape(Struct, frozen=True):
    """One zone: its number, mean and covariance in image units, and its share of the events that
    are in a zone."""

    number: int
    x: float
    y: float
    cov: tuple[tuple[float, float], tuple[float, float]]
    weight: float


class ZoneMap(Struct, frozen=True, eq=False):
    """The zones of a camera by number; ``cells`` (rows, columns) has each cell's index into
    ``zones``, or -1."""

    zones: tuple[ZoneShape, ...]
    cells: NDArray[np.int16]
    next_number: int
    events: int = 0
    """Events from which the map was learned from nothing."""


def cell_of(x: float, y: float) -> tuple[int, int]:
    """(row, column) of an image position in [0, 1]."""
    return min(int(y * GRID_ROWS), GRID_ROWS - 1), min(int(x * GRID_COLUMNS), GRID_COLUMNS - 1)


def cells_of(x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """`cell_of` for arrays of positions."""
    rows = (np.asarray(y, dtype=np.float64) * GRID_ROWS).astype(np.intp)
    columns = (np.asarray(x, dtype=np.float64) * GRID_COLUMNS).astype(np.intp)
    return np.minimum(rows, GRID_ROWS - 1), np.minimum(columns, GRID_COLUMNS - 1)


def fixed_point(x: ArrayLike) -> Longs:
    """Image positions in the fixed point of `CellSums`."""
    return np.rint(np.asarray(x, dtype=np.float64) * POSITION_ONE).astype(np.int64)


def cell_sums(x: ArrayLike, y: ArrayLike) -> CellSums:
    """The sums over a batch of positions; the learner adds and subtracts such sums."""
    rows, columns = cells_of(x, y)
    px, py = fixed_point(x), fixed_point(y)
    sums = np.zeros((6, GRID_ROWS, GRID_COLUMNS), dtype=np.int64)
    for grid, value in zip(
        sums, (np.ones_like(px), px, py, px * px, px * py, py * py), strict=True
    ):
        np.add.at(grid, (rows, columns), value)
    return CellSums(*sums)


def find_zones(
    sums: CellSums,
    previous: tuple[ZoneShape, ...] = (),
    next_number: int = 1,
    held: NDArray[np.int16] | None = None,
) -> ZoneMap:
    """The zones behind ``sums``. Those at the place of a zone of ``previous`` keep its number,
    others are numbered from ``next_number``; ``previous`` may hold zones that had vanished, which
    so get their number back when they return. ``held`` (rows, columns) is the map so far
    (`ZoneMap.cells`), changed only where the evidence is clear; None learns from nothing. Without
    events there are no zones.
    """
    flat = np.array(sums).reshape(len(sums), CELLS)
    occupied = np.flatnonzero(flat[0])
    if not len(occupied):
        return ZoneMap((), np.full((GRID_ROWS, GRID_COLUMNS), -1, dtype=np.int16), next_number)
    filled = flat[:, occupied]
    so_far = None if held is None else held.ravel()[occupied].astype(np.intp)
    rates = clutter_rates(np.asarray(sums.count))
    labels = _largest(
        partition(Cells.of(filled / _SCALE, occupied), np.asarray(sums.count), rates, so_far),
        filled[0],
    )
    groups = (labels == np.arange(labels.max() + 1)[:, None]).astype(np.int64) @ filled.T
    events, total = int(filled[0].sum()), int(groups[:, 0].sum())
    zones, next_number = match_zones(
        previous, [_shape(group, total) for group in groups.tolist()], next_number
    )
    clutter = (events / total - 1.0) * rates / rates.mean()
    return ZoneMap(zones, classify_cells(zones, clutter), next_number, events)


def refresh_zones(sums: CellSums, old: ZoneMap, gone: tuple[ZoneShape, ...] = ()) -> ZoneMap:
    """The zones now: those of ``old`` but where the evidence against them is clear. ``gone`` are
    vanished ones whose numbers may come back. While the events are few, each doubling starts from
    nothing, lest early errors stay.
    """
    known, events = old.zones + gone, int(np.asarray(sums.count).sum())
    if events >= 2 * old.events and old.events < ANEW_EVENTS_MAX:
        return find_zones(sums, known, old.next_number)
    return replace(find_zones(sums, known, old.next_number, old.cells), events=old.events)


def _largest(labels: NDArray[np.intp], events: Longs) -> NDArray[np.intp]:
    """The zone of each cell (m,), -1 for clutter, if only the `ZONES_PER_CAMERA_MAX` with the most
    ``events`` stay.
    """
    number = np.bincount(labels + 1, events)[1:]
    if len(number) <= ZONES_PER_CAMERA_MAX:
        return labels
    kept = np.sort(np.argsort(-number, kind="stable")[:ZONES_PER_CAMERA_MAX])
    renamed = np.full(len(number) + 1, -1, np.intp)  # the last is for clutter
    renamed[kept] = np.arange(len(kept))
    return renamed[labels]


def _shape(sums: list[int], total: int) -> ZoneShape:
    """Exact mean and covariance (of the events, divided by their number) of a zone's six summed
    sums.
    """
    n, sx, sy, sxx, sxy, syy = sums
    unit = (n * POSITION_ONE) ** 2
    xx, xy, yy = ((n * b - a) / unit for a, b in ((sx * sx, sxx), (sx * sy, sxy), (sy * sy, syy)))
    return ZoneShape(
        0, sx / n / POSITION_ONE, sy / n / POSITION_ONE, ((xx, xy), (xy, yy)), n / total
    )


def match_zones(
    old: tuple[ZoneShape, ...], new: list[ZoneShape], next_number: int
) -> tuple[tuple[ZoneShape, ...], int]:
    """Number the new zones: one at an old zone's place has its number, the others count up from
    ``next_number``, which is above every number ever given. Returns the zones by number and the
    next free number.

    The assignment (Hungarian) minimises the summed distances; a pair further apart than
    `MATCH_DISTANCE` is never made.
    """
    number: dict[int, int] = {}
    if old and new:
        distance = _distances(old, new)
        cost = np.minimum(distance, MATCH_DISTANCE + 1.0)
        for a, b in zip(*linear_sum_assignment(cost), strict=True):
            if distance[a, b] <= MATCH_DISTANCE:
                number[int(b)] = old[a].number
    next_number = max([next_number, *(zone.number + 1 for zone in old)])
    by_place = sorted(
        (k for k in range(len(new)) if k not in number), key=lambda k: (new[k].y, new[k].x)
    )
    for k in by_place:
        number[k] = next_number
        next_number += 1
    numbered = [
        ZoneShape(number[k], zone.x, zone.y, zone.cov, zone.weight) for k, zone in enumerate(new)
    ]
    return tuple(sorted(numbered, key=lambda zone: zone.number)), next_number


def _distances(old: tuple[ZoneShape, ...], new: list[ZoneShape]) -> Floats:
    """How far every old zone is from every new one (old, new), by the root of eight times the
    Bhattacharyya distance: the Mahalanobis distance of their centres under the mean of their
    covariances where these are alike, and more where they are not."""
    (ax, ay, *a), (bx, by, *b) = _figures(old)[:, :, None], _figures(new)[:, None, :]
    xx, xy, yy = ((one + other) / 2 for one, other in zip(a, b, strict=True))
    determinant = xx * yy - xy * xy
    dx, dy = ax - bx, ay - by
    squared = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant
    spread = (a[0] * a[2] - a[1] * a[1]) * (b[0] * b[2] - b[1] * b[1])
    return np.asarray(np.sqrt(squared + 2 * np.maximum(np.log(determinant**2 / spread), 0.0)))


def _figures(zones: Sequence[ZoneShape]) -> Floats:
    """Centres and covariances (xx, xy, yy) with `PLACE_SD_MIN` (5, zones)."""
    least = PLACE_SD_MIN**2
    return np.array(
        [(z.x, z.y, z.cov[0][0] + least, z.cov[0][1], z.cov[1][1] + least) for z in zones]
    ).T
