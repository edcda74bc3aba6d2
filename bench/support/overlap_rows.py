"""The thesis's test for overlapping views (table 4.4) over a matrix of transit times.

Zones A and B lie in one camera, C in another. If going from A to B takes as long as going from A to
C and on to B, an object passes C while it is in the first camera's view: the views overlap. Linked
cameras without such a triple have an unseen path between them; cameras without a link are not
related.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camtopod.arrays import Floats
from camtopod.topology.camera_pairs import sum_rule


class OverlapRow(NamedTuple):
    """A row of tables 5.3 and 5.4: zone C of camera ``camera_c`` lies between A and B of
    ``camera_ab``.

    Zones are indices into the matrix, transit times are seconds. ``error`` is |t(A,B) - (t(A,C) +
    t(C,B))|.
    """

    camera_ab: int
    camera_c: int
    a: int
    b: int
    c: int
    transit_ac: float
    transit_cb: float
    transit_ab: float
    error: float


def overlap_rows(
    transit: ArrayLike, camera_of_zone: ArrayLike, tolerance: float
) -> list[OverlapRow]:
    """Return every triple that shows an overlap, ordered by (A, B, C).

        transit (n, n): seconds from a zone to another, 0 where there is no link.
        camera_of_zone (n,): camera of each zone.
        tolerance (seconds): largest ``error`` of a triple.

    Of symmetric candidates, tables 5.3 and 5.4 list each pair {A, B} once, with A < B (the thesis's
    graph is undirected), and each camera in both roles. So cameras 3 and 4 have two rows in table
    5.3, and five of table 5.4's pairs appear in one role only because the other fails the test. All
    three links must exist. The sum is taken along A -> C -> B, as in table 4.4; if that fails,
    along B -> C -> A, as a matrix of measured times need not be symmetric. With table 5.2 and T =
    0.200 the result is exactly table 5.3.
    """
    times = np.asarray(transit, dtype=np.float64)
    cameras = np.asarray(camera_of_zone, dtype=np.intp)
    n = len(cameras)
    if times.shape != (n, n):
        raise ValueError(f"transit has shape {times.shape}, camera_of_zone {n} zones")
    rows = []
    for a in range(n):
        for b in np.flatnonzero((cameras == cameras[a]) & (np.arange(n) > a)):
            for c in np.flatnonzero(cameras != cameras[a]):
                forth = _row(times, cameras, a, int(b), int(c), tolerance)
                row = forth or _row(times, cameras, int(b), a, int(c), tolerance)
                if row:
                    rows.append(row)
    return rows


def _row(
    times: Floats, cameras: NDArray[np.intp], a: int, b: int, c: int, tolerance: float
) -> OverlapRow | None:
    """Return the row of a triple, or None if it fails the test or lacks a link."""
    ab, ac, cb = float(times[a, b]), float(times[a, c]), float(times[c, b])
    if 0.0 in (ab, ac, cb) or not sum_rule(ab, ac, cb, tolerance):
        return None
    return OverlapRow(int(cameras[a]), int(cameras[c]), a, b, c, ac, cb, ab, abs(ab - (ac + cb)))
