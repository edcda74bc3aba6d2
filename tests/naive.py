"""Slow, obvious twins of the fast functions, each by the definition. Arrays in, arrays out."""

import numpy as np
import scipy.signal

# --- daspec, zones (weighted grid cells against points) ---


def data_spectroscopy(points, bandwidth):
    """DaSpec over n points (n, 2) with the dense n x n kernel: kept eigenvalues and eigenvectors, label of
    each point."""
    n = len(points)
    squared = ((points[:, None, :] - points[None, :, :]) ** 2).sum(axis=2)
    values, vectors = np.linalg.eigh(np.exp(-squared / (2 * bandwidth**2)) / n)
    kept = []
    for j in reversed(range(n)):
        v = vectors[:, j]
        eps = np.abs(v).max() / n
        if values[j] > 0.5 / n and ((v > -eps).all() or (v < eps).all()):
            kept.append(j)
    labels = [int(np.argmax([abs(vectors[i, j]) for j in kept])) for i in range(n)]
    return values[kept], vectors[:, kept], np.array(labels)


def eigenfunction_labels(points, values, vectors, bandwidth, new):
    """Group of each new point (m, 2) by ``phi_g(x) = sum_i K(x, x_i) v_g(i) / (n lambda_g)``."""
    labels = []
    for x in new:
        kernel = np.exp(-((points - x) ** 2).sum(axis=1) / (2 * bandwidth**2))
        phi = [abs(kernel @ v) / (len(points) * value) for v, value in zip(vectors.T, values, strict=True)]
        labels.append(int(np.argmax(phi)))
    return np.array(labels)


def bandwidth_of_points(points):
    """The rule `camtopod.learn.daspec.bandwidth` over points (n, 2) in grid steps."""
    wanted = max(0.05 * len(points), 5)
    radii = []
    for x in points:
        distances = sorted(np.hypot(*(points - x).T))
        radii.append(next((d for i, d in enumerate(distances, 1) if i >= wanted - 1e-9), distances[-1]))
    radii.sort()
    q95 = next(r for i, r in enumerate(radii, 1) if i / len(points) >= 0.95 - 1e-9)
    return max(q95 / np.sqrt(5.991464547107979), 0.75)


def valley(positions, low, high, steps):
    """`camtopod.learn.valley.valley` over points on a line, by trying every pair of flanks and every
    valley."""
    grid = np.linspace(low, high, steps)
    best = 0.0
    for b in range(steps):
        for c in range(b + 1, steps):
            left = max((_valley_ratio(positions, grid, b, c, a, b) for a in range(b)), default=0.0)
            right = max(
                (_valley_ratio(positions, grid, b, c, c, d) for d in range(c + 1, steps)), default=0.0
            )
            best = max(best, min(left, right))
    return best


def _valley_ratio(positions, grid, b, c, f, g):
    inside = max(((positions > grid[b]) & (positions <= grid[c])).sum(), 1e-9)
    flank = max(((positions > grid[f]) & (positions <= grid[g])).sum(), 1e-9)
    rate, flank_rate = inside / (c - b), flank / (g - f)
    if rate >= 0.85 * flank_rate:
        return 0.0
    together = (inside + flank) / (c - b + g - f)
    return inside * np.log(rate / together) + flank * np.log(flank_rate / together)


def gaussian_density(points, mean, cov):
    """Eq. 2.5 with the right normaliser."""
    d = points - mean
    squared = np.einsum("ni,ij,nj->n", d, np.linalg.inv(cov), d)
    return np.exp(-squared / 2) / (2 * np.pi * np.sqrt(np.linalg.det(cov)))


# --- wiener (two correlations, as scipy has it) ---


def wiener(image, size, noise):
    """Wiener's filter over windows of ``size`` x ``size``; ``noise`` is a variance or None for scipy's
    guess."""
    return scipy.signal.wiener(image, size, noise)
