"""Array types, and operations on the rows of a table by group.

Each operation takes one pass over the rows, however many groups there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
"""Values per candidate, of which there may be millions: half the memory of `Floats`.

Sums over them are in double precision.
"""
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Rows = NDArray[np.intp]
"""Row numbers, as NumPy's own functions return them."""
Indices = NDArray[np.signedinteger[Any]]
"""Integers of any width."""
Bools = NDArray[np.bool_]


def rows_by_group(label: Indices, groups: int) -> list[NDArray[np.intp]]:
    """Return the rows of each group, ascending.

    label (n,): group of each row, from 0 to ``groups`` - 1.
    """
    narrow = label.astype(np.min_scalar_type(groups))  # of up to 16 bits, NumPy sorts in time n
    order = np.argsort(narrow, kind="stable")
    ends = np.cumsum(np.bincount(label, minlength=groups))
    return np.split(order, ends[:-1])[:groups]


def places(names: Sequence[str]) -> Rows:
    """Return the place (n,) of each of n different names when they are sorted."""
    return np.argsort(np.argsort(np.array(names, object)))


def first_of_group(group: Indices, limit: int) -> Bools:
    """Return a mask (n,) of the first rows of each group, ``limit`` of each; group (n,)."""
    order = np.argsort(group, kind="stable")
    runs = group[order]
    first = np.zeros(len(group), np.bool_)
    first[order] = np.arange(len(group)) - np.searchsorted(runs, runs) < limit
    return first


def ranges(first: Indices, length: Indices) -> tuple[Rows, Rows]:
    """Return the number of the range and the value of each element of k ranges of integers.

    first, length (k,): first element and number of elements of each range.
    """
    at = np.repeat(np.arange(len(first)), length)
    element = np.arange(len(at)) + np.repeat(first - (np.cumsum(length) - length), length)
    return at, element


def ranges_in_parts(first: Indices, length: Indices, size_max: int) -> Iterator[tuple[Rows, Rows]]:
    """Yield `ranges` with about ``size_max`` elements at a time, of at least one range."""
    cumulative = np.concatenate(([0], np.cumsum(length)))
    begin = 0
    while begin < len(first):
        end = max(
            int(np.searchsorted(cumulative, cumulative[begin] + size_max, "right")) - 1, begin + 1
        )
        at, element = ranges(first[begin:end], length[begin:end])
        yield at + begin, element
        begin = end


def find_rows(keys: Indices, targets: Indices) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the index among ``keys`` of each of the ``targets`` (n,), and whether it is there.

    Both results have shape (n,); the index of a missing key is arbitrary but valid, unless there
    are no keys at all.
    """
    if len(keys) == 0:
        return np.zeros(len(targets), np.intp), np.zeros(len(targets), np.bool_)
    order = np.argsort(keys, kind="stable")
    at = order[np.minimum(np.searchsorted(keys[order], targets), len(keys) - 1)]
    return at, keys[at] == targets


def find_pairs(
    pairs: tuple[Indices, Indices], targets: tuple[Indices, Indices]
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return what `find_rows` does, for pairs of numbers, each given as two columns."""
    size = 1 + max(int(second.max(initial=0)) for _, second in (pairs, targets))
    keys, target_keys = (
        first.astype(np.int64) * size + second for first, second in (pairs, targets)
    )
    return find_rows(keys, target_keys)


ROWS_AT_ONCE = 1024
"""Rows of a table processed together, so that intermediate results stay in the CPU's cache."""


def row_slices(rows: int) -> Iterator[slice]:
    """Yield slices of about `ROWS_AT_ONCE` rows that cover a table of ``rows`` rows.

    BLAS rounds a matrix product of few rows differently in the last bit, so the last slice takes
    the remainder instead of leaving a short one.
    """
    last = (max(rows // ROWS_AT_ONCE, 1) - 1) * ROWS_AT_ONCE
    for first in range(0, last, ROWS_AT_ONCE):
        yield slice(first, first + ROWS_AT_ONCE)
    yield slice(last, rows)
