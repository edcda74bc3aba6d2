"""Zones of one camera by other clusterings; each returns the centres of its clusters.

k-means with k by silhouette (Rousseeuw 1987), HDBSCAN (Campello, Moulavi, Sander 2013), mean shift
(Comaniciu, Meer 2002) and plain DaSpec with the bandwidth rule. Free parameters (smallest cluster,
bandwidth) are variants, so that the best one for a regime can be chosen on the ground truth. Needs
scikit-learn (the ``bench`` extra).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.learn.zones.daspec import bandwidth, data_spectroscopy
from camtopod.topology.grid import GRID_COLUMNS, GRID_ROWS

POINTS_MAX = 1500
"""Most events of a camera that k-means and HDBSCAN take; they are drawn at random."""
SILHOUETTE_POINTS_MAX = 400
"""Most events from which a silhouette is computed."""
MEAN_SHIFT_POINTS_MAX = 500
"""Most events that mean shift takes."""
CLUSTERS_MAX = 8
SILHOUETTE_MIN = 0.5
"""Least silhouette at which more than one cluster is accepted."""
SMALLEST_SHARES = (0.01, 0.03, 0.06)
"""Smallest clusters of HDBSCAN, as shares of the points."""
MEAN_SHIFT_WIDTHS = (0.04, 0.07, 0.1)
"""Bandwidths of mean shift, as fractions of the image."""
MEAN_SHIFT_SHARE_MIN = 0.03
"""Least share of the points in a cluster of mean shift, which makes one of every outlier."""
DASPEC_FACTORS = (0.7, 1.0, 1.5)
"""Multiples of the bandwidth rule's bandwidth."""


def methods() -> dict[str, dict[str, Callable[[Floats], Floats]]]:
    """Return method -> variant -> function from positions (n, 2) to centres (k, 2)."""
    return {
        "k-means": {"k by silhouette": k_means},
        "HDBSCAN": {f"smallest {s:g}": partial(hdbscan, smallest=s) for s in SMALLEST_SHARES},
        "mean shift": {f"bandwidth {w:g}": partial(mean_shift, width=w) for w in MEAN_SHIFT_WIDTHS},
        "plain DaSpec": {f"bandwidth x {f:g}": partial(daspec, factor=f) for f in DASPEC_FACTORS},
    }


def k_means(positions: Floats) -> Floats:
    """Cluster with k from 1 to `CLUSTERS_MAX`, chosen by silhouette.

    It is one cluster if no k has a silhouette above `SILHOUETTE_MIN`.
    """
    from sklearn.cluster import KMeans
    from sklearn.metrics import silhouette_score

    sample, draw = _sample(positions, POINTS_MAX), _sample(positions, SILHOUETTE_POINTS_MAX)
    best = SILHOUETTE_MIN
    centres: Floats = sample.mean(axis=0, keepdims=True)
    for k in range(2, min(CLUSTERS_MAX, len(np.unique(draw, axis=0)) - 1) + 1):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = KMeans(k, n_init=3, random_state=0).fit(sample)
            quality = float(silhouette_score(draw, model.predict(draw))) if k < len(draw) else -1.0
        if quality > best:
            best, centres = quality, model.cluster_centers_
    return centres


def hdbscan(positions: Floats, smallest: float) -> Floats:
    """Cluster by HDBSCAN; ``smallest`` is the share of the points in a cluster, at least."""
    from sklearn.cluster import HDBSCAN

    sample = _sample(positions, POINTS_MAX)
    size = max(5, round(smallest * len(sample)))
    if len(sample) <= size:
        return _centres(sample, np.zeros(len(sample), np.int64))
    return _centres(sample, HDBSCAN(min_cluster_size=size, copy=True).fit_predict(sample))


def mean_shift(positions: Floats, width: float) -> Floats:
    """Cluster by mean shift with bandwidth ``width``, a fraction of the image."""
    from sklearn.cluster import MeanShift

    sample = _sample(positions, MEAN_SHIFT_POINTS_MAX)
    model = MeanShift(bandwidth=width, bin_seeding=True).fit(sample)
    share = np.bincount(model.labels_, minlength=len(model.cluster_centers_)) / len(sample)
    centres: Floats = model.cluster_centers_[share >= MEAN_SHIFT_SHARE_MIN]
    return centres


def daspec(positions: Floats, factor: float) -> Floats:
    """Cluster by plain DaSpec with ``factor`` times the bandwidth of the rule."""
    cells = np.minimum(
        (positions * (GRID_COLUMNS, GRID_ROWS)).astype(np.int64), (GRID_COLUMNS - 1, GRID_ROWS - 1)
    )
    counts = np.zeros((GRID_ROWS, GRID_COLUMNS))
    np.add.at(counts, (cells[:, 1], cells[:, 0]), 1.0)
    groups = data_spectroscopy(counts, factor * bandwidth(counts))
    cell = cells @ (1, GRID_COLUMNS)
    return _centres(positions, groups.labels[np.searchsorted(groups.cells, cell)])


def _centres(positions: Floats, labels: NDArray[np.int64]) -> Floats:
    """Return the mean position of each label from 0 up, (labels, 2)."""
    centres = [positions[labels == k].mean(axis=0) for k in np.unique(labels[labels >= 0])]
    return np.array(centres).reshape(-1, 2)


def _sample(positions: Floats, points_max: int) -> Floats:
    """Return at most ``points_max`` positions, drawn at random."""
    rng = np.random.default_rng(0)
    return (
        positions[rng.choice(len(positions), points_max, replace=False)]
        if len(positions) > points_max
        else positions
    )
