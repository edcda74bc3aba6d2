"""Departures and arrivals: the window's exits and entries as columns, the input of the joint
fit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints


class Departures(NamedTuple):
    """Objects leaving, by time, (n,) each: ``t`` seconds, ``zone``, ``camera``, ``since`` when the
    passage began (-inf: unknown), its log slowness (nan: unknown), the arrival that began it (-1:
    unknown), and the block of the image where it left (-1: no position). Where there are delayed
    copies (see `long_ways`), ``of`` is the row of each departure's original, for an original its
    own: together they have at most one arrival.
    """

    t: Floats
    zone: Ints
    camera: Ints
    since: Floats
    slow: Floats
    own: Ints
    block: Ints
    of: Indices | None = None

    def take(self, kept: NDArray[np.bool_], arrivals: NDArray[np.bool_]) -> Departures:
        """The departures ``kept`` when of the arrivals only those of the mask ``arrivals`` are."""
        number = np.append(np.where(arrivals, np.cumsum(arrivals) - 1, -1), -1).astype(
            np.int32
        )  # -1 looks at the last
        own = number[self.own[kept]]
        return Departures(
            self.t[kept],
            self.zone[kept],
            self.camera[kept],
            self.since[kept],
            self.slow[kept],
            own,
            self.block[kept],
        )

    @staticmethod
    def untold(t: Floats, zone: Ints, camera: Ints, since: Floats, slow: Floats) -> Departures:
        """Departures of which nothing is known of the arrival and the block."""
        unknown = np.full(len(t), -1, np.int32)
        return Departures(t, zone, camera, since, slow, unknown, unknown)


class Arrivals(NamedTuple):
    """Objects appearing, by time, (n,) each: ``t`` seconds, ``zone``, ``camera``, the local rate of
    arrivals there (1/s), and the log slowness of the passage that begins (nan: unknown).
    """

    t: Floats
    zone: Ints
    camera: Ints
    rate: Floats
    slow: Floats

    def take(self, kept: NDArray[Any]) -> Arrivals:
        """The arrivals ``kept``: a mask, or rows."""
        return Arrivals(
            self.t[kept], self.zone[kept], self.camera[kept], self.rate[kept], self.slow[kept]
        )
