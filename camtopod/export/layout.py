"""Camera positions on the map: distances follow the number of hops, so that neighbours are close.

Stress majorisation (Gansner, Koren & North 2004) of each connected part; the parts are packed
beside each other. Deterministic, and stable: the search starts from the previous positions, so a
small change of the network moves cameras a little.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, shortest_path
from scipy.spatial.distance import cdist

from camtopod.arrays import Floats

Place = tuple[float, float]
"""Position (x, y), in lengths of an unseen path."""

OVERLAPPED_LENGTH = 0.7
"""Length of an edge between overlapping views; an unseen path has length 1."""
MARGIN = 0.9
"""Space between connected parts."""
SINGLE = (0.8, 0.7)
"""Width and height of the space of a camera that is joined with no other."""


def places(
    names: Iterable[str], joined: Mapping[tuple[str, str], bool], before: Mapping[str, Place]
) -> dict[str, Place]:
    """Return the position of each camera; an unseen path is about 1 long, y grows downwards.

    joined: for pairs of names, whether their views overlap.
    before: positions in an earlier version, if any.
    """
    # The network as a graph.
    order = sorted(names)
    number = {name: k for k, name in enumerate(order)}
    pairs = np.array([(number[a], number[b]) for a, b in joined], int).reshape(-1, 2)
    length = np.where(list(joined.values()), OVERLAPPED_LENGTH, 1.0)
    graph = coo_matrix((length, pairs.T), shape=(len(order), len(order))).tocsr()
    count, part = connected_components(graph, directed=False)

    # Lay out each connected part, largest first, and pack them.
    sizes = np.bincount(part, minlength=count)
    at = np.zeros((len(order), 2))
    boxes = []
    for label in sorted(
        range(count), key=lambda label: (-sizes[label], int(np.argmax(part == label)))
    ):
        members = np.flatnonzero(part == label)
        held = [before.get(order[k]) for k in members]
        apart = shortest_path(graph[members][:, members], directed=False)
        at[members] = _one_part(apart, held)
        boxes.append(members)
    _pack(at, boxes)
    stayed = [k for k, name in enumerate(order) if name in before]

    # Keep the cameras of before in place on the whole, even if a part grew to the left.
    if stayed:
        at += np.median([before[order[k]] for k in stayed] - at[stayed], axis=0)
    return {
        name: (round(float(at[k, 0]), 3), round(float(at[k, 1]), 3)) for k, name in enumerate(order)
    }


def _one_part(apart: Floats, held: list[Place | None]) -> Floats:
    """Return positions (n, 2) around the origin of a connected part.

    apart (n, n): graph distances.
    held: previous positions.
    """
    n = len(apart)
    if n == 1:
        return np.zeros((1, 2))

    # From the previous positions, if half of them are known; new cameras start near neighbours.
    known = np.array([place is not None for place in held])
    if known.sum() * 2 >= n:
        at = np.array([place or (np.nan, np.nan) for place in held], float)
        for k in np.flatnonzero(~known):
            near = known & (apart[k] <= apart[k][known].min() + 1e-9)
            at[k] = at[near].mean(0) + 0.3 * np.array([np.cos(2.4 * k), np.sin(2.4 * k)])
        return _majorised(apart, at, rounds=25)

    # Afresh, with the longer side horizontal.
    at = _majorised(apart, _scaled(apart), rounds=60)
    if np.ptp(at[:, 0]) < np.ptp(at[:, 1]):
        at = at[:, ::-1].copy()
    return at


def _scaled(apart: Floats) -> Floats:
    """Return positions by classical scaling: the two widest dimensions of the distances.

    The sign of a dimension is that of its first clear entry.
    """
    n = len(apart)
    squared = apart**2
    inner = -0.5 * (squared - squared.mean(0) - squared.mean(1)[:, None] + squared.mean())
    value, vector = eigh(inner, subset_by_index=[max(0, n - 2), n - 1])
    at: Floats = np.zeros((n, 2))
    for k in range(len(value)):
        column = vector[:, -1 - k] * np.sqrt(max(value[-1 - k], 0.0))
        at[:, k] = column * (
            np.sign(column[np.argmax(np.abs(column) > 0.5 * np.abs(column).max())]) or 1.0
        )
    # Separate cameras that coincide.
    at += 0.05 * np.column_stack([np.cos(2.4 * np.arange(n)), np.sin(2.4 * np.arange(n))])
    return at


def _majorised(apart: Floats, at: Floats, rounds: int) -> Floats:
    """Return positions (n, 2) of less stress.

    Stress is the sum of (distance / graph distance - 1)^2 over pairs of cameras.
    """
    n = len(apart)
    wanted = apart + np.eye(n)
    weight = 1.0 / wanted**2
    np.fill_diagonal(weight, 0.0)
    laplacian = np.diag(weight.sum(1)) - weight
    solve = np.linalg.inv(laplacian + 1.0 / n) - 1.0 / n
    pull = weight * wanted
    for _ in range(rounds):
        distance = np.maximum(cdist(at, at), 1e-6)
        ratio = pull / distance
        at = solve @ (ratio.sum(1)[:, None] * at - ratio @ at)
    return at


def _pack(at: Floats, parts: list[NDArray[np.intp]]) -> None:
    """Move the parts (rows of ``at``), largest first, onto shelves beside each other, in place.

    Cameras that are joined with no other stand in even rows below.
    """
    joined = [rows for rows in parts if len(rows) > 1]
    single = [int(rows[0]) for rows in parts if len(rows) == 1]
    sizes = [np.ptp(at[rows], axis=0) + MARGIN for rows in joined]
    total = sum(float(size.prod()) for size in sizes) + len(single) * SINGLE[0] * SINGLE[1]
    width = max([float((total * 1.6) ** 0.5), *(float(size[0]) for size in sizes)])

    # Parts of several cameras.
    x = y = shelf = 0.0
    for rows, size in zip(joined, sizes, strict=True):
        if x > 0 and x + size[0] > width + 1e-9:
            x = 0.0
            y += shelf
            shelf = 0.0
        at[rows] += np.array([x, y]) + MARGIN / 2 - at[rows].min(0)
        x += float(size[0])
        shelf = max(shelf, float(size[1]))

    # Single cameras, in rows of nearly the same length, each centred.
    if single:
        rows_of_singles = -(-len(single) // max(1, round(width / SINGLE[0])))
        for k, row in enumerate(np.array_split(single, rows_of_singles)):
            middle = np.arange(len(row)) - (len(row) - 1) / 2
            at[row, 0] = width / 2 + SINGLE[0] * middle
            at[row, 1] = y + shelf + SINGLE[1] * (k + 0.5)
