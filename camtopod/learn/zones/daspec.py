"""Data spectroscopy (DaSpec): spectral clustering of weighted grid cells (thesis 2.4, 4.2, 5.1).

Source: Shi, Belkin, Yu, "Data spectroscopy: eigenspaces of convolution operators and clustering",
Annals of Statistics 37(6B), 2009. There, n points and a bandwidth w give the matrix
``K_ij = exp(-|x_i - x_j|^2 / 2 w^2) / n``. Its eigenvectors that do not change sign are the
clusters, and a point belongs to the one with the largest entry at the point. Here points are events
on a grid: points in the same cell have the same row in K, so ``n D^1/2 K D^1/2`` over the occupied
cells, where D holds each cell's share of the points, has the same nonzero eigenvalues.

Distances are in grid steps, for rows and columns alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from camtopod.arrays import Floats

SHARE_NEAR = 0.05
"""Share of all points that makes up a point's neighbourhood in `bandwidth` (the authors' 5 %)."""
POINTS_NEAR_MIN = 5
"""Least number of points in a neighbourhood in `bandwidth`, as 5 % of 15 points is less than one.
"""
BANDWIDTH_MIN = 0.75
"""Least bandwidth, grid steps; a narrower kernel resolves the grid instead of the points."""
_CHI_95 = float(np.sqrt(2.0 * gammaincinv(1.0, 0.95)))
"""Root of the 95 % quantile of chi-squared with two degrees of freedom."""


class Spectrum(NamedTuple):
    """Result of DaSpec on a grid of counts: G groups of the m occupied cells.

    Each group belongs to an eigenvector that does not change sign.

    cells (m,): flat index of each occupied cell, ascending.
    values (G,): eigenvalues, descending.
    vectors (m, G): entry of each *point* of a cell in each eigenvector; these have unit length
        over all points.
    labels (m,): group of each occupied cell.
    """

    cells: NDArray[np.intp]
    values: Floats
    vectors: Floats
    labels: NDArray[np.intp]

    @property
    def groups(self) -> int:
        """Number of groups, G."""
        return len(self.values)


def kernel_1d(size: int, bandwidth: float) -> Floats:
    """Return the Gaussian kernel (size, size) between the grid positions along one axis.

    bandwidth: standard deviation, grid steps.

    The kernel between cells is the product of the kernels along both axes.
    """
    steps = np.arange(size)
    kernel: Floats = np.exp(-0.5 * ((steps[:, None] - steps) / bandwidth) ** 2)
    return kernel


def data_spectroscopy(counts: NDArray[np.generic], bandwidth: float) -> Spectrum:
    """Group the occupied cells of a grid by DaSpec.

    counts (rows, columns): points in each cell; at least one is positive.
    bandwidth: of the kernel, grid steps.

    An eigenvector v is kept if it does not change sign, up to ``max|v| / n``. Its sign is fixed so
    that its largest entry is positive, so the result depends on the counts alone.
    """
    # The occupied cells, and the kernel matrix over them.
    grid = np.asarray(counts, dtype=np.float64)
    cells = np.flatnonzero(grid)
    rows, columns = (kernel_1d(size, bandwidth) for size in grid.shape)
    r, c = np.divmod(cells, grid.shape[1])
    weights = grid.ravel()[cells]
    n = float(weights.sum())
    root = np.sqrt(weights / n)
    matrix = rows[np.ix_(r, r)] * columns[np.ix_(c, c)] * root[:, None] * root

    # The eigenvalues, the largest first, and their eigenvectors, per point. Up to about 400 cells,
    # computing all of them is faster than computing the largest ones only.
    values, vectors = np.linalg.eigh(matrix)
    values = values[::-1]
    vectors = vectors[:, ::-1] / np.sqrt(weights)[:, None]
    # Even a group of one point has an eigenvalue of at least 1/n; smaller ones are rounding errors.
    real = values >= min(0.5 / n, values[0])
    values = values[real]
    vectors = vectors[:, real]

    # Keep the eigenvectors that do not change sign.
    peaks = np.abs(vectors).argmax(axis=0)
    vectors = vectors * np.sign(vectors[peaks, np.arange(len(peaks))])
    mask = vectors.min(axis=0) >= -vectors.max(axis=0) / n
    values = values[mask]
    vectors = vectors[:, mask]

    # A cell belongs to the group of its largest eigenvector.
    labels = np.abs(vectors).argmax(axis=1)
    return Spectrum(cells, values, vectors, labels)


def bandwidth(counts: NDArray[np.generic]) -> float:
    """Return the DaSpec bandwidth, in grid steps, for a grid of points without clutter.

    counts (rows, columns): points in each cell.

    The bandwidth is the 95 % quantile, over points, of the radius of a point's neighbourhood,
    divided by the root of the 95 % quantile of chi-squared. This is the authors' rule with two
    changes. For grids of few points, a neighbourhood is the circle that holds 5 % of the points
    *and* at least five, its own included. For many points in a narrow door, which all share a cell,
    the result is at least `BANDWIDTH_MIN`.
    """
    # Radius of the neighbourhood of each occupied cell.
    grid = np.asarray(counts, dtype=np.float64)
    cells = np.flatnonzero(grid)
    weights = grid.ravel()[cells]
    r, c = np.divmod(cells, grid.shape[1])
    distances = (r[:, None] - r) ** 2 + (c[:, None] - c) ** 2
    order = distances.argsort(axis=1, kind="stable")
    cumulative = np.cumsum(weights[order], axis=1)
    weight_needed = min(max(SHARE_NEAR * weights.sum(), POINTS_NEAR_MIN), float(weights.sum()))
    last = (cumulative >= weight_needed - 1e-9).argmax(axis=1)
    radius = np.sqrt(np.take_along_axis(distances, order, axis=1)[np.arange(len(cells)), last])

    # The 95 % quantile of the radii, over points.
    by_radius = radius.argsort(kind="stable")
    share = np.cumsum(weights[by_radius]) / weights.sum()
    return max(float(radius[by_radius[(share >= 0.95 - 1e-9).argmax()]]) / _CHI_95, BANDWIDTH_MIN)
