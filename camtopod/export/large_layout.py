"""Camera positions of a large connected part, in memory that grows with its cameras.

Of the graph distances only those to pivots and to near cameras count: pivot MDS (Brandes & Pich
2006) for the start, then sparse stress (Ortmann, Klimenta & Brandes 2016). Deterministic.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.csgraph import dijkstra

from camtopod.arrays import Floats

PIVOTS_MAX = 64
"""Cameras to which all distances are known."""
NEAR_LENGTH = 2.5
"""Graph distance up to which cameras are near each other, in lengths of an unseen path."""
SEARCHES = 500
"""Cameras whose near ones are looked for at a time."""


def large_places(graph: Any, start: Floats | None, aside: Floats, rounds: int) -> Floats:
    """Return positions (n, 2) of the cameras of a connected graph.

    graph (n, n): sparse, the length of each edge.
    start (n, 2): positions from which to begin; None: none are known.
    aside (n, 2): small steps, which part cameras that begin at one place.
    rounds: of majorisation.
    """
    pivots, apart = _pivots(graph)
    near, lengths = _near(graph)

    # Weights: a pivot stands for the cameras that are nearest to it and nearer to it than half the
    # way to the camera that is placed.
    region = apart.argmin(1)
    weight = np.zeros_like(apart)
    for k in range(len(pivots)):
        radii = np.sort(apart[region == k, k])
        weight[:, k] = np.searchsorted(radii, apart[:, k] / 2, "right")
    weight /= np.maximum(apart, 1e-9) ** 2
    weight[apart <= NEAR_LENGTH] = 0.0  # which are among the near ones
    near_weight = 1.0 / lengths**2
    total = weight.sum(1) + np.bincount(near[0], near_weight, len(apart))

    # Each round moves every camera to the mean of where the others would have it.
    at = _pivot_places(apart) + aside if start is None else start
    for _ in range(rounds):
        away = at[:, None] - at[pivots]
        pull = weight * apart / np.maximum(np.linalg.norm(away, axis=2), 1e-6)
        drift = weight @ at[pivots] + (pull[:, :, None] * away).sum(1)
        beside = at[near[0]] - at[near[1]]
        push = near_weight * lengths / np.maximum(np.linalg.norm(beside, axis=1), 1e-6)
        for axis in (0, 1):
            terms = near_weight * at[near[1], axis] + push * beside[:, axis]
            drift[:, axis] += np.bincount(near[0], terms, len(at))
        at = (at + drift / total[:, None]) / 2
    return at


def _pivots(graph: Any) -> tuple[list[int], Floats]:
    """Return pivots, each as far as possible from those before, and distances (n, pivots)."""
    pivots: list[int] = []
    columns: list[Floats] = []
    nearest = np.full(graph.shape[0], np.inf)
    while len(pivots) < min(PIVOTS_MAX, graph.shape[0]):
        pivots.append(int(nearest.argmax()))
        columns.append(dijkstra(graph, directed=False, indices=pivots[-1]))
        nearest = np.minimum(nearest, columns[-1])
    return pivots, np.column_stack(columns)


def _near(graph: Any) -> tuple[Any, Floats]:
    """Return the pairs (2, m) of cameras near each other, both ways, and distances (m,)."""
    pairs, lengths = [], []
    for first in range(0, graph.shape[0], SEARCHES):
        rows = np.arange(first, min(first + SEARCHES, graph.shape[0]))
        apart = dijkstra(graph, directed=False, indices=rows, limit=NEAR_LENGTH)
        at = np.nonzero(np.isfinite(apart) & (apart > 0))
        pairs.append(np.array([rows[at[0]], at[1]]))
        lengths.append(apart[at])
    return np.hstack(pairs), np.concatenate(lengths)


def _pivot_places(apart: Floats) -> Floats:
    """Return positions (n, 2) by the distances (n, pivots), the wider dimension across."""
    squares = apart**2
    inner = squares.mean(0) + squares.mean(1)[:, None] - squares - squares.mean()
    _, _, axes = np.linalg.svd(inner, full_matrices=False)
    places: Floats = inner @ axes[:2].T
    return places * (apart.std() / places.std())
