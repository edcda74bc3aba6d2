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
"""Cameras to which all distances count, each as far as possible from those before."""
NEAR = 2.0
"""Graph distance of near cameras, to which no pivot's counts, in lengths of an unseen path."""


def large_places(graph: Any, start: Floats | None, aside: Floats, rounds: int) -> Floats:
    """Return positions (n, 2) of the cameras of a connected graph.

    graph (n, n): sparse, the length of each edge once.
    start (n, 2): positions from which to begin; None: none are known.
    aside (n, 2): small steps, which part cameras that begin at one place.
    rounds: of majorisation.
    """
    pivots: list[int] = []
    apart = np.full((graph.shape[0], 1), np.inf)
    while len(pivots) < min(PIVOTS_MAX, len(apart)):
        pivots.append(int(apart.min(1).argmax()))
        column = dijkstra(graph, directed=False, indices=pivots[-1])
        apart = np.column_stack([apart, column])
    apart = apart[:, 1:]

    # A pivot stands for the cameras that it is nearest to, within half the way to it.
    weight = np.where(apart > NEAR, 1.0 / np.maximum(apart, NEAR) ** 2, 0.0)
    region = apart.argmin(1)
    for k, column in enumerate(apart.T):
        weight[:, k] *= np.searchsorted(np.sort(column[region == k]), column / 2, "right")

    # Near cameras: neighbours, and their neighbours at the mean length of the ways there.
    edges = (graph + graph.T).tocsr()
    ways = edges.sign()
    beyond = (edges @ ways + ways @ edges).multiply((ways @ ways).power(-1)).tocsr()
    beyond.setdiag(0)
    near = (edges + beyond - beyond.multiply(ways)).tocoo()
    near.eliminate_zeros()
    pull = 1.0 / near.data
    total = weight.sum(1) + np.bincount(near.row, pull / near.data, len(apart))

    # Each round moves every camera to the mean of where the others would have it.
    at = _pivot_places(apart) + aside if start is None else start
    for _ in range(rounds):
        away = at[:, None] - at[pivots]
        push = weight * apart / np.maximum(np.linalg.norm(away, axis=2), 1e-6)
        drift = weight @ at[pivots] + (push[:, :, None] * away).sum(1)
        beside = at[near.row] - at[near.col]
        push = pull / np.maximum(np.linalg.norm(beside, axis=1), 1e-6)
        terms = (pull / near.data)[:, None] * at[near.col] + push[:, None] * beside
        drift += np.column_stack([np.bincount(near.row, term, len(at)) for term in terms.T])
        at = (at + drift / total[:, None]) / 2
    return at


def _pivot_places(apart: Floats) -> Floats:
    """Return positions (n, 2) by the distances (n, pivots), the wider dimension across."""
    squares = apart**2
    inner = squares.mean(0) + squares.mean(1)[:, None] - squares - squares.mean()
    _, _, axes = np.linalg.svd(inner, full_matrices=False)
    places: Floats = inner @ axes[:2].T
    places *= apart.std() / places.std()
    return places
