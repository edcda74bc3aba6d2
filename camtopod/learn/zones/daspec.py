"""Data spectroscopy (DaSpec) over weighted grid cells (thesis sections 2.4, 4.2, 5.1).

Source: Shi, Belkin, Yu, "Data spectroscopy: eigenspaces of convolution operators and clustering",
Annals of Statistics 37(6B), 2009. There, n points give the matrix
``K_ij = exp(-|x_i - x_j|^2 / 2 w^2) / n``. Points in the same grid cell have the same row, so the
matrix is equivalent to ``D^1/2 K D^1/2`` over the occupied cells, where D holds each cell's share
of the points. It has the same nonzero eigenvalues, and the entry of a point in an eigenvector is
that of its cell divided by the root of the cell's count. The cost does not depend on the number of
points, only on the number of occupied cells.

Distances are in grid steps, for rows and columns alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from camtopod.arrays import Floats

SHARE_NEAR = 0.05
"""Share of all points that makes up a point's neighbourhood: the authors' 5 % quantile."""
POINTS_NEAR_MIN = 5
"""Least points in a neighbourhood in `bandwidth`: 5 % of 15 points is less than one."""
BANDWIDTH_MIN = 0.75
"""Least bandwidth, grid steps; a narrower kernel resolves the grid instead of the points."""
EIGENVECTORS_MAX = 48
"""Most eigenvectors considered, and so most groups."""
_CHI_95 = float(np.sqrt(2.0 * gammaincinv(1.0, 0.95)))
"""Root of the 95 % quantile of chi-squared with two degrees of freedom."""


class Spectrum(NamedTuple):
    """The kept eigenvectors of a grid of counts: G groups over m occupied cells.

    shape: rows and columns of the grid.
    bandwidth: of the kernel, grid steps.
    counts (m,): points in each occupied cell.
    cells (m,): flat index of each occupied cell.
    values (G,): eigenvalues, descending.
    vectors (m, G): entry of each *point* in the cell in each unit eigenvector over all points.
    labels (m,): group of each occupied cell.
    """

    shape: tuple[int, int]
    bandwidth: float
    counts: Floats
    cells: NDArray[np.intp]
    values: Floats
    vectors: Floats
    labels: NDArray[np.intp]

    @property
    def groups(self) -> int:
        """Number of groups G, which is that of the kept eigenvectors."""
        return len(self.values)

    def grid(self) -> NDArray[np.int16]:
        """Return the group of each cell (rows, columns), -1 where the cell is empty."""
        table = np.full(self.shape[0] * self.shape[1], -1, dtype=np.int16)
        table[self.cells] = self.labels
        return table.reshape(self.shape)


def kernel_1d(size: int, bandwidth: float) -> Floats:
    """Return the Gaussian kernel (size, size) along one axis of the grid.

    The kernel over both axes is the product of the two.
    """
    steps = np.arange(size)
    kernel: Floats = np.exp(-0.5 * ((steps[:, None] - steps) / bandwidth) ** 2)
    return kernel


def data_spectroscopy(counts: NDArray[np.generic], bandwidth: float) -> Spectrum:
    """Group the occupied cells of ``counts`` (rows, columns), at least one of which is positive.

    An eigenvector is kept if it does not change sign, up to ``max|v| / n``. Its sign is fixed so
    that its largest entry is positive, which makes the result a function of the counts.
    """
    # The occupied cells, and the kernel matrix over them.
    grid = np.asarray(counts, dtype=np.float64)
    cells = np.flatnonzero(grid)
    if not len(cells):
        raise ValueError("no points: all counts are zero")
    rows, columns = (kernel_1d(size, bandwidth) for size in grid.shape)
    r, c = np.divmod(cells, grid.shape[1])
    weights = grid.ravel()[cells]
    n = float(weights.sum())
    root = np.sqrt(weights / n)
    matrix = rows[np.ix_(r, r)] * columns[np.ix_(c, c)] * root[:, None] * root

    # The largest eigenvalues and their eigenvectors, per point. Up to about 400 cells, computing
    # all of them is faster than computing the largest ones only.
    values, vectors = np.linalg.eigh(matrix)
    values, vectors = values[: -EIGENVECTORS_MAX - 1 : -1], vectors[:, : -EIGENVECTORS_MAX - 1 : -1]
    vectors = vectors / np.sqrt(weights)[:, None]
    # Even a group of one point has an eigenvalue of at least 1/n; smaller ones are rounding noise.
    real = values >= min(0.5 / n, values[0])
    values, vectors = values[real], vectors[:, real]

    # Keep the eigenvectors that do not change sign.
    peaks = np.abs(vectors).argmax(axis=0)
    vectors = vectors * np.sign(vectors[peaks, np.arange(len(peaks))])
    kept = vectors.min(axis=0) >= -vectors.max(axis=0) / n
    values, vectors = values[kept], vectors[:, kept]

    # A cell belongs to the group of its largest eigenvector.
    labels = np.abs(vectors).argmax(axis=1)
    shape = (grid.shape[0], grid.shape[1])
    return Spectrum(shape, bandwidth, weights, cells, values, vectors, labels)


def bandwidth(counts: NDArray[np.generic]) -> float:
    """Return the bandwidth in grid steps for counts (rows, columns) without clutter.

    The authors' rule with two changes. A neighbourhood is the circle around a point that holds 5 %
    of the points *and* at least five, itself included, for grids of few points. The result is at
    least `BANDWIDTH_MIN`, for many points in narrow doors, which all share a cell.
    """
    # Radius of the neighbourhood of each occupied cell.
    grid = np.asarray(counts, dtype=np.float64)
    cells = np.flatnonzero(grid)
    weights = grid.ravel()[cells]
    r, c = np.divmod(cells, grid.shape[1])
    distances = (r[:, None] - r) ** 2 + (c[:, None] - c) ** 2
    order = distances.argsort(axis=1, kind="stable")
    reached = np.cumsum(weights[order], axis=1)
    wanted = min(max(SHARE_NEAR * weights.sum(), POINTS_NEAR_MIN), float(weights.sum()))
    last = (reached >= wanted - 1e-9).argmax(axis=1)
    radius = np.sqrt(np.take_along_axis(distances, order, axis=1)[np.arange(len(cells)), last])

    # The 95 % quantile of the radii, over points.
    by_radius = radius.argsort(kind="stable")
    share = np.cumsum(weights[by_radius]) / weights.sum()
    return max(float(radius[by_radius[(share >= 0.95 - 1e-9).argmax()]]) / _CHI_95, BANDWIDTH_MIN)
