"""Data Spectroscopy over weighted grid cells (thesis sections 2.4, 4.2, 5.1).

Source: Shi, Belkin, Yu, "Data spectroscopy: eigenspaces of convolution operators and clustering",
Annals of Statistics 37(6B), 2009. There, n points give the matrix ``K_ij = exp(-|x_i - x_j|^2 / 2
w^2) / n``. Points that lie in the same grid cell share their row, so the operator is the same as
``D^1/2 K D^1/2`` over the occupied cells, D being each cell's share of the points: the same
eigenvalues (but for zeros), and the eigenvector of a point is that of its cell divided by the root
of the cell's count. It costs the same for a hundred points as for ten million.

Distances are in grid steps, rows and columns alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from camtopod.arrays import Floats

SHARE_NEAR = 0.05
"""The authors' 5 % quantile: a point's own neighbourhood."""
POINTS_NEAR_MIN = 5
"""Our rule wants this many points in a neighbourhood: 5 % of 15 points is less than one."""
BANDWIDTH_MIN = 0.75
"""Grid steps. Below it the kernel sees the grid instead of the points."""
EIGENVECTORS_MAX = 48
"""At most this many eigenvectors are looked at, so there are at most as many groups."""


def _chi_95(d: int) -> float:
    """Root of the 95 % quantile of chi-squared with ``d`` degrees of freedom (`scipy.stats` takes
    long to load).
    """
    return float(np.sqrt(2.0 * gammaincinv(d / 2.0, 0.95)))


class Spectrum(NamedTuple):
    """The kept eigenvectors of a grid of counts: G groups over m occupied cells.

    ``vectors[c, g]`` is the value at any *point* in cell ``cells[c]`` (a flat index) of the g-th
    unit eigenvector over all points; ``values`` are the eigenvalues, falling; ``labels`` has each
    occupied cell's group.
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
        """G, how many groups: as many as eigenvectors are kept."""
        return len(self.values)

    def grid(self) -> NDArray[np.int16]:
        """Group of each cell, -1 where the cell is empty; shape (rows, columns)."""
        table = np.full(self.shape[0] * self.shape[1], -1, dtype=np.int16)
        table[self.cells] = self.labels
        return table.reshape(self.shape)

    def extend(self) -> NDArray[np.int16]:
        """Group of a new point in each cell by the eigenfunction ``phi(x) = sum_i K(x, x_i) v(i) /
        (n lambda)``."""
        rows, columns = (kernel_1d(size, self.bandwidth) for size in self.shape)
        phi = np.empty((self.groups, *self.shape))
        total = self.counts.sum()
        for g in range(self.groups):
            weighted = np.zeros(self.shape[0] * self.shape[1])
            weighted[self.cells] = self.counts * self.vectors[:, g] / total
            phi[g] = rows @ weighted.reshape(self.shape) @ columns / self.values[g]
        labels: NDArray[np.int16] = np.abs(phi).argmax(axis=0).astype(np.int16)
        return labels


def kernel_1d(size: int, bandwidth: float) -> Floats:
    """Gaussian kernel along one axis of the grid, shape (size, size); the kernel of two axes is
    their product."""
    steps = np.arange(size)
    kernel: Floats = np.exp(-0.5 * ((steps[:, None] - steps) / bandwidth) ** 2)
    return kernel


def data_spectroscopy(counts: NDArray[np.generic], bandwidth: float) -> Spectrum:
    """Group the occupied cells of ``counts`` (rows, columns), at least one of them positive.

    An eigenvector is kept when it does not change sign up to ``max|v| / n``. Its sign is fixed so
    that its largest entry is positive, which makes the result a function of the counts.
    """
    grid = np.asarray(counts, dtype=np.float64)
    cells = np.flatnonzero(grid)
    if not len(cells):
        raise ValueError("no points")
    rows, columns = (kernel_1d(size, bandwidth) for size in grid.shape)
    r, c = np.divmod(cells, grid.shape[1])
    weights = grid.ravel()[cells]
    n = float(weights.sum())
    root = np.sqrt(weights / n)
    matrix = rows[np.ix_(r, r)] * columns[np.ix_(c, c)] * root[:, None] * root
    # All of them at once are found sooner than the largest ones only, up to some 400 cells.
    values, vectors = np.linalg.eigh(matrix)
    values, vectors = values[: -EIGENVECTORS_MAX - 1 : -1], vectors[:, : -EIGENVECTORS_MAX - 1 : -1]
    vectors = vectors / np.sqrt(weights)[:, None]
    # A group of even one point has an eigenvalue of at least 1/n: below lies only rounding noise.
    real = values >= min(0.5 / n, values[0])
    values, vectors = values[real], vectors[:, real]
    peaks = np.abs(vectors).argmax(axis=0)
    vectors = vectors * np.sign(vectors[peaks, np.arange(len(peaks))])
    kept = vectors.min(axis=0) >= -vectors.max(axis=0) / n
    values, vectors = values[kept], vectors[:, kept]
    labels = np.abs(vectors).argmax(axis=1)
    shape = (grid.shape[0], grid.shape[1])
    return Spectrum(shape, bandwidth, weights, cells, values, vectors, labels)


def authors_bandwidth(points: Floats) -> float:
    """The authors' rule ``Q95_i(Q05_j |x_i - x_j|) / sqrt(chi2_{0.95, d})`` over points of shape
    (n, d).

    On repeated grid positions it collapses (0.63 for table 5.1's points, zero when most repeat),
    with clutter it blows up; `bandwidth` below is what the zones use.
    """
    distances = np.sqrt(((points[:, None, :] - points[None, :, :]) ** 2).sum(axis=2))
    near = np.quantile(distances, 0.05, axis=1)
    return float(np.quantile(near, 0.95) / _chi_95(points.shape[1]))


def bandwidth(counts: NDArray[np.generic]) -> float:
    """Bandwidth in grid steps for a grid of counts (rows, columns) from which clutter has been
    taken out.

    The authors' rule with two changes. A neighbourhood is the circle that holds 5 % of the points
    *and* at least five, itself included, which few points need; and the result is at least
    `BANDWIDTH_MIN`, which many points in tight doors need, for they all share a cell.
    """
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
    by_radius = radius.argsort(kind="stable")
    share = np.cumsum(weights[by_radius]) / weights.sum()
    return max(
        float(radius[by_radius[(share >= 0.95 - 1e-9).argmax()]]) / _chi_95(2), BANDWIDTH_MIN
    )
