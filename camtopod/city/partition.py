"""Cut a city into districts: connected groups of cameras of much the same size, few passages cut.

The cut is that of METIS (Karypis and Kumar, SIAM Journal on Scientific Computing 20(1), 1998), by
the package `pymetis` of the extra ``[city]``, which no other module needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pymetis
from scipy.sparse import coo_array, csgraph

WEIGHT_MAX = 10_000
"""Weight of the pair with most passages. METIS adds up integers of 32 bits."""
IMBALANCE = 200
"""Thousandths by which a district may be larger than the mean, so that the cut finds gaps."""
CUTS = 10
"""Cuts that are tried from different starts; the best counts."""
SEED = 1
"""Of these starts, so that the same city is cut in the same way."""


def partition(
    cameras: Sequence[str], passages: Mapping[tuple[str, str], float], cameras_max: int
) -> dict[str, str]:
    """Return the district of each camera, ``d1``, ``d2`` ... in order of their first cameras.

    cameras: different names.
    passages: by pair of cameras, the number of objects that go from one to the other, or anything
        else that is larger where more do.
    cameras_max: most cameras of a district.

    A district is connected, unless it is put together of places that nothing connects. Raises
    ValueError if METIS finds no cut with ``cameras_max``, which is so for a few cameras at most.
    """
    graph = _graph(cameras, passages)
    adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
    options = pymetis.Options(contig=1, ufactor=IMBALANCE, ncuts=CUTS, seed=SEED)
    for count in range(-(-len(cameras) // cameras_max), len(cameras) + 1):
        _, membership = pymetis.part_graph(
            count, adjacency, eweights=graph.data, recursive=False, options=options
        )
        if np.bincount(membership).max() <= cameras_max:
            names = {number: f"d{k}" for k, number in enumerate(dict.fromkeys(membership), 1)}
            return {
                camera: names[number] for camera, number in zip(cameras, membership, strict=True)
            }
    raise ValueError(f"there is no cut into districts of at most {cameras_max} cameras")


def _graph(cameras: Sequence[str], passages: Mapping[tuple[str, str], float]) -> coo_array:
    """Return the symmetric matrix of weights between cameras, connected (sparse, by rows).

    METIS only keeps districts connected if the whole graph is. So its components are joined by
    their first cameras, with the least weight.
    """
    index = {camera: k for k, camera in enumerate(cameras)}
    pairs = np.array([[index[a], index[b]] for a, b in passages], np.int32).reshape(-1, 2)
    weights = np.array(list(passages.values()), float)
    weights = 1 + np.rint(WEIGHT_MAX * weights / max(weights.max(initial=0.0), 1e-9))

    size = (len(cameras), len(cameras))
    _, part = csgraph.connected_components(coo_array((weights, pairs.T), size), directed=False)
    first = np.unique(part, return_index=True)[1]
    a, b = np.concatenate((pairs, np.stack((first[:-1], first[1:]), axis=1))).T
    weight = np.concatenate((weights, np.ones(len(first) - 1))).astype(np.int32)
    matrix = coo_array((weight, (a, b)), size)
    return (matrix + matrix.T).tocsr()
