"""Grouping of rows for all groups at once, against a scan of all rows for each group."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from camtopod import arrays as module
from camtopod.arrays import rows_by_group, sum_by_group, table_rows

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


@given(st.lists(st.integers(0, 29), max_size=40), st.booleans())
def test_every_key_has_its_row(key: list[int], many: bool) -> None:
    with pytest.MonkeyPatch.context() as limits:
        limits.setattr(module, "ALL_KEYS_MAX", 29 if many else 30)
        keys, row = table_rows(np.array(key, np.int64), 30)
    assert keys.tolist() == (sorted(set(key)) if many else list(range(30)))
    assert keys[row].tolist() == key


@given(LABELS, st.integers(0, 10**6))
def test_sums_of_each_group(group: list[int], seed: int) -> None:
    rows = np.random.default_rng(seed).random((len(group), 3))
    slow = [
        [sum(rows[k, c] for k, own in enumerate(group) if own == g) for c in range(3)]
        for g in range(GROUPS)
    ]
    assert sum_by_group(rows, np.array(group, np.int64), GROUPS) == pytest.approx(np.array(slow))
