"""Grouping of rows for all groups at once, against a scan of all rows for each group."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from camtopod.arrays import rows_by_group

GROUPS = 7
LABELS = st.lists(st.integers(0, GROUPS - 1), max_size=40)


@given(LABELS, st.sampled_from([np.int32, np.int64]))
def test_rows_of_each_group_ascend_and_are_all_there(label: list[int], kind: type) -> None:
    found = rows_by_group(np.array(label, kind), GROUPS)
    assert [rows.tolist() for rows in found] == [
        [row for row, own in enumerate(label) if own == group] for group in range(GROUPS)
    ]


def test_no_groups_have_no_rows() -> None:
    assert rows_by_group(np.zeros(0, np.int64), 0) == []
    assert [len(rows) for rows in rows_by_group(np.zeros(0, np.int64), 3)] == [0, 0, 0]
