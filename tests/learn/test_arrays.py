"""Grouping of rows and looking up of pairs for all at once, against a scan for each of them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from camtopod.arrays import find_pairs, rows_by_group

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


PAIRS = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=20)


@given(st.sets(st.tuples(st.integers(0, 5), st.integers(0, 5))).map(list), PAIRS)
def test_pairs_are_found_where_they_are(
    pairs: list[tuple[int, int]], wanted: list[tuple[int, int]]
) -> None:
    columns = (np.array(table, np.int32).reshape(-1, 2).T for table in (pairs, wanted))
    rows, exists = find_pairs(*((first, second) for first, second in columns))
    assert exists.tolist() == [pair in pairs for pair in wanted]
    assert [pairs[row] for row in rows[exists]] == [pair for pair in wanted if pair in pairs]
