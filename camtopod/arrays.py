"""Array types, and operations on rows by group: one pass over the rows, however many groups there
are.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
"""Figures of each candidate, of which there may be millions: half the memory. Sums are in double
precision.
"""
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Rows = NDArray[np.intp]
"""Row numbers, as NumPy's own functions return them."""
Indices = NDArray[np.signedinteger[Any]]
"""Integers of any width."""
Bools = NDArray[np.bool_]

ALL_KEYS_MAX = 1000
SHORT_MAX = np.iinfo(np.int16).max
"""Indices up to this are sorted as 16 bits, which NumPy does by radix: ten times as fast as longer
ones.
"""


def rows_of(label: Indices, groups: int) -> list[NDArray[np.intp]]:
    """The rows of each group, ascending; ``label`` (n,): group of each row, 0 to ``groups`` - 1."""
    order = np.argsort(label.astype(np.int16) if groups <= SHORT_MAX else label, kind="stable")
    return np.split(order, np.cumsum(np.bincount(label, minlength=groups))[:-1]) if groups else []


def numbered(key: Indices, keys: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Keys worth a row of a table, ascending, and the row of each ``key`` (n,), 0 to ``keys`` - 1.

    All keys while they are few, those that occur where they are many.
    """
    if keys <= ALL_KEYS_MAX:
        return np.arange(keys), key.astype(np.int64)
    present, row = np.unique(key, return_inverse=True)
    return present.astype(np.int64), row.astype(np.int64)


def summed(rows: Floats, group: Indices, groups: int) -> Floats:
    """Sums (groups, columns) of the rows of each group."""
    result = np.zeros((groups, rows.shape[1]))
    order = np.argsort(group, kind="stable")
    present, first, number = np.unique(group[order], return_index=True, return_counts=True)
    one, two, more = (
        number == 1,
        number == 2,
        number > 2,
    )  # most are of one or two, which is done far quicker
    result[present[one]] = rows[order[first[one]]]
    result[present[two]] = rows[order[first[two]]] + rows[order[first[two] + 1]]
    if more.any():
        begin = np.cumsum(number[more]) - number[more]
        result[present[more]] = np.add.reduceat(rows[order[np.repeat(more, number)]], begin, axis=0)
    return result


def rows_at(keys: Indices, wanted: Indices) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Where each of the ``wanted`` (n,) is among the ``keys``, and whether it is there at all: (n,)
    each.
    """
    if len(keys) == 0:
        return np.zeros(len(wanted), np.intp), np.zeros(len(wanted), np.bool_)
    order = np.argsort(keys, kind="stable")
    at = order[np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)]
    return at, keys[at] == wanted


ROWS_AT_ONCE = 1024
"""Rows of a table worked on together, so that intermediate results stay in the processor's
cache.
"""


def rows_together(rows: int) -> Iterator[slice]:
    """Of a table with so many rows, some at a time. A product of few rows is reckoned otherwise and
    would differ in the last bit from one of all rows, so the last has the rest, too.
    """
    parts = max(rows // ROWS_AT_ONCE, 1)
    for k in range(parts):
        yield slice(k * ROWS_AT_ONCE, rows if k + 1 == parts else (k + 1) * ROWS_AT_ONCE)
