"""Find the entry and exit zones of one camera from the sums over its grid (thesis 2.4, 2.8, 4.2).

The input are integer sums per grid cell (`cell_sums`), so the cost of finding zones does not depend
on the number of events. `find_zones` has `partition` group the cells.
Each group becomes a zone (`ZoneShape`) with exact mean and covariance and with a number that it
keeps while it stays in place. The result is a `ZoneMap`: the zones, and a table that assigns each
cell of the grid to a zone or to clutter. `refresh_zones` adapts a map to later events.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from camtopod.arrays import Floats, Longs
from camtopod.learn.limits import ZONES_PER_CAMERA_MAX
from camtopod.learn.zones.cells import CELLS, Cells
from camtopod.learn.zones.clutter import clutter_rates
from camtopod.learn.zones.marginal_likelihood import ZONE_SD
from camtopod.learn.zones.mixture import ZoneShape, classify_cells
from camtopod.learn.zones.partition import partition
from camtopod.topology import GRID_COLUMNS, GRID_ROWS, POSITION_ONE

ANEW_EVENTS_MAX = 4000
"""A map that was learned from nothing with at least this many events is only adapted later."""
FAR = 3.0
"""Distance, in standard deviations, beyond which two zones are not at the same place."""
_SCALE = np.array(
    [1, POSITION_ONE, POSITION_ONE, POSITION_ONE**2, POSITION_ONE**2, POSITION_ONE**2]
)[:, None]
"""Factors from the six sums in image units to fixed point."""


class ZoneMap(Struct, frozen=True, eq=False):
    """The zones of a camera, and the zone of each grid cell.

    zones: sorted by number.
    cells (rows, columns): index into ``zones`` of the zone of each cell, or -1 for clutter.
    next_number: the number of the next new zone; numbers are never reused for another zone.
    """

    zones: tuple[ZoneShape, ...]
    cells: NDArray[np.int16]
    next_number: int
    events: int = 0
    """Number of events when the map was last learned from nothing."""


def find_zones(
    sums: Longs,
    previous: tuple[ZoneShape, ...] = (),
    next_number: int = 1,
    start: NDArray[np.int16] | None = None,
) -> ZoneMap:
    """Find the zones of a camera from its sums (`cell_sums`); without events there are none.

    previous: earlier zones of the camera; a new zone at the place of one of them gets its number.
        Vanished zones may be among them.
    next_number: number of the first zone that is at the place of no earlier one.
    start (rows, columns): an earlier map (`ZoneMap.cells`), which is changed only where the
        evidence is clear; None to learn from nothing.
    """
    # The cells that have events.
    count = sums[0]
    flat = sums.reshape(len(sums), CELLS)
    cell_rows = np.flatnonzero(flat[0])
    if not len(cell_rows):
        return ZoneMap((), np.full((GRID_ROWS, GRID_COLUMNS), -1, dtype=np.int16), next_number)

    # Assign these cells to groups, of which at most `ZONES_PER_CAMERA_MAX` become zones.
    cell_columns = flat[:, cell_rows]
    so_far = None if start is None else start.ravel()[cell_rows].astype(np.intp)
    rates = clutter_rates(count)
    labels = _largest(
        partition(Cells.of(cell_columns / _SCALE, cell_rows), count, rates, so_far), cell_columns[0]
    )

    # Make zones from the exact sums (groups, 6), and number them like earlier zones in their place.
    groups = (labels == np.arange(labels.max() + 1)[:, None]).astype(np.int64) @ cell_columns.T
    events = int(cell_columns[0].sum())
    total = int(groups[:, 0].sum())
    zones, next_number = match_zones(
        previous, [_shape(group, total) for group in groups.tolist()], next_number
    )

    # Assign every cell of the grid, with events or without, to a zone or to clutter.
    clutter = (events / total - 1.0) * rates / rates.mean()
    return ZoneMap(zones, classify_cells(zones, clutter), next_number, events)


def refresh_zones(sums: Longs, old: ZoneMap, vanished_zones: tuple[ZoneShape, ...] = ()) -> ZoneMap:
    """Return the map ``old`` adapted to the present sums where the evidence for a change is clear.

    vanished_zones: vanished zones of the camera; a zone at the place of one of them gets its number
        back.

    While events are few (`ANEW_EVENTS_MAX`), the zones are learned from nothing whenever the number
    of events has doubled, so that early errors do not persist.
    """
    zones_before = old.zones + vanished_zones
    events = int(sums[0].sum())
    if events >= 2 * old.events and old.events < ANEW_EVENTS_MAX:
        return find_zones(sums, zones_before, old.next_number)
    return replace(find_zones(sums, zones_before, old.next_number, old.cells), events=old.events)


def _largest(labels: NDArray[np.intp], events: Longs) -> NDArray[np.intp]:
    """Return the labels (m,) with only the `ZONES_PER_CAMERA_MAX` zones with most events kept.

    labels (m,): zone of each cell, -1 for clutter.
    events (m,): number of events of each cell.
    """
    number = np.bincount(labels + 1, events)[1:]
    if len(number) <= ZONES_PER_CAMERA_MAX:
        return labels
    largest_groups = np.sort(np.argsort(-number, kind="stable")[:ZONES_PER_CAMERA_MAX])
    new_label = np.full(len(number) + 1, -1, np.intp)  # the last is for clutter
    new_label[largest_groups] = np.arange(len(largest_groups))
    return new_label[labels]


def _shape(sums: list[int], total: int) -> ZoneShape:
    """Return a zone with the exact mean and covariance of its events; its number is still 0.

    sums: the six sums (`cell_sums`) over the zone's events.
    total: number of events in all zones of the camera.
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
    """Number the zones ``new``; return them sorted by number, and the next free number.

    A new zone at the place of an old one takes the old one's number. Other new zones are numbered
    from ``next_number`` on, or above the numbers of ``old`` if that is more, in order of their
    position (y, then x).
    """
    number = {k: old[at].number for k, at in same_places(old, new).items()}

    # Number the new zones that match no old one.
    next_number = max([next_number, *(zone.number + 1 for zone in old)])
    by_place = sorted(
        (k for k in range(len(new)) if k not in number), key=lambda k: (new[k].y, new[k].x)
    )
    for k in by_place:
        number[k] = next_number
        next_number += 1

    # Sort by number.
    result = [
        ZoneShape(number[k], zone.x, zone.y, zone.cov, zone.weight) for k, zone in enumerate(new)
    ]
    return tuple(sorted(result, key=lambda zone: zone.number)), next_number


def same_places(old: Sequence[ZoneShape], new: Sequence[ZoneShape]) -> dict[int, int]:
    """Return, by index of a zone of ``new``, that of the zone of ``old`` at its place, if any.

    They are matched one to one by the Hungarian method, which minimises the sum of their distances
    (`_distances`, capped just above `FAR`). Zones further apart than `FAR` are not matched.
    """
    if not (old and new):
        return {}
    distance = _distances(old, new)
    rows, columns = linear_sum_assignment(np.minimum(distance, FAR + 1.0))
    near = distance[rows, columns] <= FAR
    return dict(zip(columns[near].tolist(), rows[near].tolist(), strict=True))


def _distances(old: Sequence[ZoneShape], new: Sequence[ZoneShape]) -> Floats:
    """Return the distance (old, new) of every old zone from every new one, in standard deviations.

    The distance is the root of eight times the Bhattacharyya distance. For zones of the same
    covariance, that is the Mahalanobis distance of their centres; for others, it is more.
    """
    (ax, ay, *a) = _figures(old)[:, :, None]
    (bx, by, *b) = _figures(new)[:, None, :]
    xx, xy, yy = ((cov_a + cov_b) / 2 for cov_a, cov_b in zip(a, b, strict=True))
    determinant = xx * yy - xy * xy
    dx = ax - bx
    dy = ay - by
    square = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant
    spread = (a[0] * a[2] - a[1] * a[1]) * (b[0] * b[2] - b[1] * b[1])
    return np.asarray(np.sqrt(square + 2 * np.maximum(np.log(determinant**2 / spread), 0.0)))


def _figures(zones: Sequence[ZoneShape]) -> Floats:
    """Return the centre and the covariance, widened by `ZONE_SD`, of each zone.

    The result is (5, zones): x, y and the covariance as xx, xy, yy.
    """
    least = ZONE_SD**2
    return np.array(
        [(z.x, z.y, z.cov[0][0] + least, z.cov[0][1], z.cov[1][1] + least) for z in zones]
    ).T
