"""Classification by the Gaussian mixture (thesis 2.8)."""

from __future__ import annotations

import naive
import numpy as np

from camtopod.learn.zones.cells import cells_of, fixed_point
from camtopod.learn.zones.mixture import ZoneShape, classify_cells

CELL = np.diag([1 / (12 * 24**2), 1 / (12 * 30**2)])
A = ZoneShape(1, 0.3, 0.4, ((0.0020, 0.0008), (0.0008, 0.0030)), 0.8)
B = ZoneShape(2, 0.5, 0.5, ((0.0009, -0.0002), (-0.0002, 0.0004)), 0.2)
CENTRES = np.array([((c + 0.5) / 24, (r + 0.5) / 30) for r in range(30) for c in range(24)])


def test_posterior_decides() -> None:
    density = [
        naive.gaussian_density(CENTRES, np.array([z.x, z.y]), np.array(z.cov) + CELL) * z.weight
        for z in (A, B)
    ]
    expected = np.stack([np.full(720, 0.25), *density]).argmax(axis=0) - 1
    cells = classify_cells((A, B), 0.25)
    assert (cells.ravel() == expected).all()
    assert set(cells.ravel().tolist()) == {-1, 0, 1}


def test_a_zone_narrower_than_a_cell_has_its_cell() -> None:
    point = ZoneShape(1, 0.71, 0.33, ((0.0, 0.0), (0.0, 0.0)), 1.0)
    cells = classify_cells((point,), 0.3)
    assert cells.flat[cells_of(*fixed_point((0.71, 0.33)))] == 0
    assert 1 <= (cells == 0).sum() <= 9
