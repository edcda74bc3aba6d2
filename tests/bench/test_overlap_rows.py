"""The overlap test reproduces the thesis's tables 5.3 and 5.4."""

from __future__ import annotations

import numpy as np
import pytest

from bench.support.overlap_rows import overlap_rows
from bench.support.thesis_tables import (
    TABLE_5_2,
    TABLE_5_2_CAMERAS,
    TABLE_5_3,
    TABLE_5_4,
    TABLE_5_4_CAMERAS,
    table_5_4_transit,
)


def test_table_5_3_exactly() -> None:
    rows = overlap_rows(TABLE_5_2, TABLE_5_2_CAMERAS, 0.200)
    listed = [
        (
            r.camera_ab,
            r.camera_c,
            r.a + 1,
            r.b + 1,
            r.c + 1,
            r.transit_ac,
            r.transit_cb,
            r.transit_ab,
        )
        for r in rows
    ]
    assert listed == TABLE_5_3


def test_table_5_3_needs_its_tolerance() -> None:
    assert len(overlap_rows(TABLE_5_2, TABLE_5_2_CAMERAS, 0.100)) == 2
    assert len(overlap_rows(TABLE_5_2, TABLE_5_2_CAMERAS, 0.450)) == 4


@pytest.mark.parametrize("row", TABLE_5_4)
def test_table_5_4_but_for_the_row_its_own_figures_contradict(row: tuple) -> None:
    """Row by row, as the last two rows contradict each other."""
    rows = overlap_rows(table_5_4_transit(row), TABLE_5_4_CAMERAS, 0.450)
    found = [(r.camera_ab, r.camera_c, r.a + 1, r.b + 1, r.c + 1) for r in rows]
    if row == TABLE_5_4[-1]:
        assert abs(row[7] - (row[5] + row[6])) == pytest.approx(0.60)
        assert row[:5] not in found
    else:
        assert row[:5] in found


def test_row_at_exactly_the_tolerance_holds() -> None:
    transit = np.array([[0, 4.45, 1.6], [4.45, 0, 3.3], [1.6, 3.3, 0]])
    assert abs(4.45 - (1.6 + 3.3)) > 0.45  # in floating point
    assert len(overlap_rows(transit, [3, 3, 4], 0.45)) == 1
    assert not overlap_rows(transit, [3, 3, 4], 0.4499)


def test_every_link_must_exist() -> None:
    full = np.array([[0, 5, 2], [5, 0, 3], [2, 3, 0]], dtype=float)
    assert len(overlap_rows(full, [1, 1, 2], 0.1)) == 1
    for a, b in ((0, 1), (0, 2), (2, 1)):
        broken = full.copy()
        broken[a, b] = broken[b, a] = 0
        assert not overlap_rows(broken, [1, 1, 2], 10.0)


def test_either_direction_shows_it() -> None:
    one_way = np.array([[0, 0, 0], [5, 0, 3], [2, 0, 0]], dtype=float)  # only B -> C -> A is linked
    (row,) = overlap_rows(one_way, [1, 1, 2], 0.1)
    assert (row.a, row.b, row.c) == (1, 0, 2)


def test_zones_of_one_camera_never_overlap_themselves() -> None:
    transit = np.array([[0, 5, 2], [5, 0, 3], [2, 3, 0]], dtype=float)
    assert not overlap_rows(transit, [1, 1, 1], 1.0)


def test_shape_is_checked() -> None:
    with pytest.raises(ValueError, match="3 zones"):
        overlap_rows(np.zeros((2, 2)), [1, 1, 2], 0.1)
