"""Figures of a version that are computed for all zones at once equal those of each zone."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from camtopod.predict.outcomes import EXPOSURE_MIN, exposures
from camtopod.topology import LagBins

BINS = LagBins(-60.0, 60.0)


@given(st.integers(0, 10**6))
def test_exposure_is_the_share_of_the_passages_that_had_begun(seed: int) -> None:
    chance = np.random.default_rng(seed)
    stay = np.sort(chance.uniform(0.0, 90.0, (4, 11)), axis=1).astype(np.float32)
    stay[chance.random(4) < 0.3] = 0.0
    found = exposures(stay, BINS)

    for row, deciles in zip(found, stay, strict=True):
        expected = np.ones(BINS.size)
        if deciles.any():
            past = BINS.edges[1:] <= 0
            begun = 1.0 - np.interp(-BINS.centres[past], deciles, np.linspace(0.0, 1.0, 11))
            expected[past] = np.clip(begun, EXPOSURE_MIN, 1.0)
        np.testing.assert_allclose(row, expected, atol=1e-6)
