"""What a user has declared of the site, as factors for pairs of cameras.

Two cameras are neighbours if objects go from one to the other without passing a third one. A pair
that was declared neither way is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camtopod.arrays import Floats, Singles
from camtopod.records import Declared

NEIGHBOURS_ODDS = 10.0
"""How much likelier a path is between declared neighbours than between cameras of which nothing is
known, and between these than between cameras that are declared not to be neighbours.
"""


def declared_odds(declarations: Declared | None, cameras: Sequence[str]) -> Floats | None:
    """Return the odds (cameras, cameras) of a path, beside those of an unknown pair.

    None if nothing is declared of pairs. Declared cameras that are not among ``cameras`` are left
    out.
    """
    if declarations is None or not (declarations.neighbours or declarations.not_neighbours):
        return None
    number = {camera: k for k, camera in enumerate(cameras)}
    odds = np.ones((len(number), len(number)))
    for pairs, factor in (
        (declarations.not_neighbours, 1.0 / NEIGHBOURS_ODDS),
        (declarations.neighbours, NEIGHBOURS_ODDS),
    ):
        for a, b in pairs:
            if a in number and b in number:
                odds[number[a], number[b]] = odds[number[b], number[a]] = factor
    return odds


def favours(odds: Floats) -> Singles:
    """Return the factors on the rates of candidates that odds of their paths make.

    They are at most 1, so that no candidate counts for more than its times tell.
    """
    factors: Singles = np.minimum(odds, 1.0).astype(np.float32)
    return factors
