"""Places of the cameras on the map: by how many hops they are apart, so that neighbours lie beside
each other.

Stress majorisation (Gansner, Koren & North 2004) of each connected part, parts packed beside each
other. From the same network the same places; a network that changes a little moves a little, as the
search starts from the old places.
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

OVERLAPPED_LENGTH = 0.7
"""Length of an edge between overlapping views; an unseen path has 1."""
ROUNDS_FRESH, ROUNDS_MOVED = 60, 25
MARGIN = 0.9
"""Room between parts."""
WIDE = 1.6
"""Width over height that the packed parts aim at."""


def places(
    names: Iterable[str], joined: Mapping[tuple[str, str], bool], before: Mapping[str, Place]
) -> dict[str, Place]:
    """Where each camera is drawn; an unseen path is about 1 long, y grows downwards.

    ``joined``: pairs of names -> whether their views overlap. ``before``: the places of an earlier
    version, if any.
    """
    order = sorted(names)
    number = {name: k for k, name in enumerate(order)}
    pairs = [
        (number[a], number[b], OVERLAPPED_LENGTH if close else 1.0)
        for (a, b), close in sorted(joined.items())
    ]
    a, b, length = (
        (np.array(column) for column in zip(*pairs, strict=True))
        if pairs
        else (np.zeros(0, int),) * 3
    )
    graph = coo_matrix((length.astype(float), (a, b)), shape=(len(order), len(order))).tocsr()
    count, part = connected_components(graph, directed=False)
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
    if stayed:  # a part that grew to the left is no reason for all to go to the right
        at += np.median([before[order[k]] for k in stayed] - at[stayed], axis=0)
    return {
        name: (round(float(at[k, 0]), 3), round(float(at[k, 1]), 3)) for k, name in enumerate(order)
    }


def _one_part(apart: Floats, held: list[Place | None]) -> Floats:
    """Places (n, 2) around the origin of a connected part with graph distances ``apart`` (n, n)."""
    n = len(apart)
    if n == 1:
        return np.zeros((1, 2))
    known = np.array([place is not None for place in held])
    if known.sum() * 2 >= n:
        at = np.array([place or (np.nan, np.nan) for place in held], float)
        for k in np.flatnonzero(
            ~known
        ):  # beside those it is joined with, each on a side of its own
            near = known & (apart[k] <= apart[k][known].min() + 1e-9)
            at[k] = at[near].mean(0) + 0.3 * np.array([np.cos(2.4 * k), np.sin(2.4 * k)])
        return _majorised(apart, at, ROUNDS_MOVED)
    at = _majorised(apart, _scaled(apart), ROUNDS_FRESH)
    return at if np.ptp(at[:, 0]) >= np.ptp(at[:, 1]) else at[:, ::-1].copy()


def _scaled(apart: Floats) -> Floats:
    """Classical scaling: the two widest dimensions of the distances; the sign is that of the first
    clear entry.
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
    at += 0.05 * np.column_stack(
        [np.cos(2.4 * np.arange(n)), np.sin(2.4 * np.arange(n))]
    )  # none upon another
    return at


def _majorised(apart: Floats, at: Floats, rounds: int) -> Floats:
    """Places (n, 2) of less stress, sum over pairs of (distance / graph distance - 1)^2."""
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
    """Shift the parts (rows of ``at``), largest first, onto shelves beside each other."""
    sizes = [np.ptp(at[rows], axis=0) + MARGIN for rows in parts]
    total = sum(float(size.prod()) for size in sizes)
    width = (
        max([float((total * WIDE) ** 0.5), *(float(size[0]) for size in sizes)]) if sizes else 0.0
    )
    x = y = shelf = 0.0
    for rows, size in zip(parts, sizes, strict=True):
        if x > 0 and x + size[0] > width + 1e-9:
            x, y, shelf = 0.0, y + shelf, 0.0
        at[rows] += np.array([x, y]) + MARGIN / 2 - at[rows].min(0)
        x, shelf = x + float(size[0]), max(shelf, float(size[1]))
