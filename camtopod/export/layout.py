"""Camera positions on the map: distances follow the number of hops, so that neighbours are close.

Stress majorisation (Gansner, Koren & North 2004) of each connected part; the parts are packed
beside each other. Deterministic, and stable: the search starts from the previous positions, so a
small change of the network moves cameras a little. `large_layout` does the same for large parts.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, shortest_path
from scipy.spatial.distance import cdist

from camtopod.arrays import Floats
from camtopod.export.large_layout import large_places

Place = tuple[float, float]
"""Position (x, y), in lengths of an unseen path."""

OVERLAPPED_LENGTH = 0.7
"""Length of an edge between overlapping views; an unseen path has length 1."""
MARGIN = 0.8
"""Space around a connected part."""
KEPT_MAX = 60
"""Cameras up to which each connected part stays where it was, rather than all being packed again.
"""
APART_MIN = 0.5
"""Least distance of cameras of different parts, across or down, if they keep their places."""
DENSE_MAX = 1_000
"""Cameras of a connected part of which all distances count."""


def places(
    names: Iterable[str], edges: Mapping[tuple[str, str], bool], before: Mapping[str, Place]
) -> dict[str, Place]:
    """Return the position of each camera; an unseen path is about 1 long, y grows downwards.

    edges: for pairs of names, whether their views overlap.
    before: positions in an earlier version, if any.
    """
    # The network as a graph.
    order = sorted(names)
    number = {name: k for k, name in enumerate(order)}
    pairs = np.array([(number[a], number[b]) for a, b in edges], int).reshape(-1, 2)
    length = np.where(list(edges.values()), OVERLAPPED_LENGTH, 1.0)
    graph = coo_matrix((length, pairs.T), shape=(len(order), len(order))).tocsr()
    count, part = connected_components(graph, directed=False)

    # Lay out each connected part, then put them beside each other, largest first.
    start = np.array([before.get(name, (np.nan, np.nan)) for name in order]).reshape(-1, 2)
    at = np.zeros((len(order), 2))
    parts = sorted((np.flatnonzero(part == k) for k in range(count)), key=len, reverse=True)
    for members in parts:
        at[members] = _one_part(graph[members][:, members], start[members])
    is_old = ~np.isnan(start[:, 0])
    if is_old.any() and len(order) <= KEPT_MAX:
        _put_where_they_were(at, start, parts)
    else:
        _put_on_shelves(at, parts)
        # Keep the cameras of before in place on the whole, even if a part grew to the left.
        if is_old.any():
            at += np.median((start - at)[is_old], axis=0)
    return {name: (x, y) for name, (x, y) in zip(order, np.round(at, 3).tolist(), strict=True)}


def _one_part(graph: Any, start: Floats) -> Floats:
    """Return positions (n, 2) of a connected part.

    graph (n, n): sparse, the length of each edge.
    start (n, 2): previous positions, or nan.
    """
    n = len(start)
    if n == 1:
        return np.zeros((1, 2))
    turn = 2.4 * np.arange(n)
    aside = np.column_stack([np.cos(turn), np.sin(turn)])
    apart = shortest_path(graph, directed=False) if n <= DENSE_MAX else None

    # From the previous positions, if half of them are known; new cameras start near neighbours.
    is_old = ~np.isnan(start[:, 0])
    if is_old.sum() * 2 >= n:
        at = start.copy()
        new = np.flatnonzero(~is_old)
        for k, row in zip(new, shortest_path(graph, directed=False, indices=new), strict=True):
            near = is_old & (row <= row[is_old].min() + 1e-9)
            at[k] = start[near].mean(0) + 0.3 * aside[k]
        if apart is None:
            return large_places(graph, at, aside, rounds=25)
        return _majorised(apart, at, rounds=25)
    if apart is None:
        return large_places(graph, None, 0.05 * aside, rounds=60)

    # Else from classical scaling: the two widest dimensions of the distances, the wider across.
    squares = apart**2
    inner = -0.5 * (squares - squares.mean(0) - squares.mean(1)[:, None] + squares.mean())
    value, vector = eigh(inner, subset_by_index=[n - 2, n - 1])
    plane = (vector * np.sqrt(np.maximum(value, 0.0)))[:, ::-1]
    return _majorised(apart, plane + 0.05 * aside, rounds=60)


def _majorised(apart: Floats, at: Floats, rounds: int) -> Floats:
    """Return positions (n, 2) of less stress.

    Stress is the sum of (distance / graph distance - 1)^2 over pairs of cameras.
    """
    n = len(apart)
    target = apart + np.eye(n)
    weight = 1.0 / target**2
    np.fill_diagonal(weight, 0.0)
    laplacian = np.diag(weight.sum(1)) - weight
    solve = np.linalg.inv(laplacian + 1.0 / n) - 1.0 / n
    pull = weight * target
    for _ in range(rounds):
        distance = np.maximum(cdist(at, at), 1e-6)
        ratio = pull / distance
        at = solve @ (ratio.sum(1)[:, None] * at - ratio @ at)
    return at


def _put_where_they_were(at: Floats, start: Floats, parts: list[NDArray[np.intp]]) -> None:
    """Move the parts (rows of ``at``) to where they were, or as near as there is room, in place.

    start (n, 2): previous positions, or nan; a part without any is put near the middle.
    """
    middle = np.nanmean(start, axis=0)
    turn = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    around = np.column_stack([np.cos(turn), np.sin(turn)])
    obstacles = np.empty((0, 2))
    for rows in parts:
        is_old = ~np.isnan(start[rows, 0])
        moves = (start - at)[rows[is_old]] if is_old.any() else middle - at[rows]
        at[rows] += np.median(moves, axis=0)
        for step in itertools.count():
            shifts = 0.2 * step * around
            apart = np.abs((at[rows] + shifts[:, None])[:, :, None] - obstacles).max(-1)
            if (is_free := (apart > APART_MIN).all((1, 2))).any():
                break
        at[rows] += shifts[is_free.argmax()]
        obstacles = np.concatenate([obstacles, at[rows]])


def _put_on_shelves(at: Floats, parts: list[NDArray[np.intp]]) -> None:
    """Move the parts (rows of ``at``) beside each other, in rows of like length, in place."""
    sizes = [np.ptp(at[rows], axis=0) + MARGIN for rows in parts]
    area = sum(float(size.prod()) for size in sizes)
    width = max([(area * 1.6) ** 0.5, *(float(size[0]) for size in sizes)])
    x = y = height = 0.0
    for rows, size in zip(parts, sizes, strict=True):
        if x + size[0] > width + 1e-9:
            x = 0.0
            y += height
            height = 0.0
        at[rows] += np.array([x, y]) + MARGIN / 2 - at[rows].min(0)
        x += float(size[0])
        height = max(height, float(size[1]))
