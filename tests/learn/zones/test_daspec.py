"""DaSpec over weighted cells equals DaSpec over points, and agrees with thesis and authors."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from bench.support.thesis_tables import FIGURE_4_4_ZONES, TABLE_5_1, figure_4_4
from camtopod.learn.zones.cells import cell_sums, fixed_point
from camtopod.learn.zones.daspec import bandwidth, data_spectroscopy

SHAPE = (30, 24)


def grid_of(points: np.ndarray) -> np.ndarray:
    grid = np.zeros(SHAPE, dtype=np.int64)
    np.add.at(grid, tuple(points.T), 1)
    return grid


def blobs(seed: int, sizes: list[int], sd: float) -> np.ndarray:
    """Return points (n, 2) of whole grid steps, a blob for each size."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform((4, 4), (26, 20), (len(sizes), 2))
    points = np.concatenate(
        [c + sd * rng.standard_normal((n, 2)) for c, n in zip(centres, sizes, strict=True)]
    )
    return np.clip(np.rint(points), 0, (29, 23)).astype(int)


TABLE = np.array([(row, column) for row, column, _ in TABLE_5_1])
TABLE_ZONES = np.array([zone for _, _, zone in TABLE_5_1])


@example(1484, [19, 7, 14, 5], 2.4375, 0.875)
@example(1484, [19, 5, 7, 14], 2.4375, 0.875)
@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10_000),
    st.lists(st.integers(3, 25), min_size=1, max_size=4),
    st.floats(0.5, 3),
    st.floats(0.6, 4),
)
def test_equals_the_operator_over_points(
    seed: int, sizes: list[int], sd: float, width: float
) -> None:
    points = blobs(seed, sizes, sd)
    spectrum = data_spectroscopy(grid_of(points), width)
    values, vectors, labels = naive.data_spectroscopy(points.astype(float), width)

    # Eigenvectors of nearly equal eigenvalues, as of single points apart, are hardly determined.
    squared = ((points[:, None, :] - points) ** 2).sum(axis=2)
    every = np.linalg.eigvalsh(np.exp(-squared / (2 * width**2)) / len(points))
    own, twin = (
        (np.abs(kept[:, None] - every) < 1e-7).sum(axis=1) == 1
        for kept in (spectrum.values, values)
    )
    assert np.allclose(spectrum.values[own], values[twin], atol=1e-10)
    position = {int(cell): i for i, cell in enumerate(spectrum.cells)}
    at = [position[int(r * SHAPE[1] + c)] for r, c in points]
    assert np.allclose(np.abs(spectrum.vectors[at][:, own]), np.abs(vectors[:, twin]), atol=1e-6)
    if not (own.all() and twin.all()):
        return
    sure = np.ptp(np.sort(np.abs(vectors), axis=1)[:, -2:], axis=1) > 1e-6
    assert (spectrum.labels[at] == labels)[sure].all()


def test_table_5_1_gives_its_two_zones() -> None:
    grid = grid_of(TABLE)
    assert 3 <= bandwidth(grid) <= 4
    found = data_spectroscopy(grid, bandwidth(grid))
    labels = found.labels[np.searchsorted(found.cells, TABLE @ (SHAPE[1], 1))]
    assert (labels == 0).sum() == (TABLE_ZONES == 1).sum() or (labels == 0).sum() == (
        TABLE_ZONES == 2
    ).sum()
    assert set(zip(labels.tolist(), TABLE_ZONES.tolist(), strict=True)) in (
        {(0, 1), (1, 2)},
        {(0, 2), (1, 1)},
    )


@pytest.mark.parametrize("seed", range(2))
def test_bandwidth_equals_the_rule_over_points(seed: int) -> None:
    points = blobs(seed, [10, 40, 25 * seed + 1], 1.0 + seed / 2)
    assert bandwidth(grid_of(points)) == pytest.approx(
        naive.bandwidth_of_points(points.astype(float))
    )


def test_plain_daspec_on_the_simulation_of_figure_4_4() -> None:
    """Without clutter the plain method performs as in the thesis."""
    positions, _ = figure_4_4(0)
    groups = []
    for place in positions:
        grid = cell_sums(*fixed_point(place.T))[0]
        groups.append(data_spectroscopy(grid, bandwidth(grid)).groups)
    assert tuple(groups) == FIGURE_4_4_ZONES
