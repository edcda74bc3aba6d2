"""Departures and arrivals: exits and entries of the window as columns, the input of the fits."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints


class Departures(NamedTuple):
    """Departures sorted by time; each column has shape (n,).

    t: time in seconds.
    zone, camera: index of the zone and of the camera.
    since: time in seconds when the passage that ends began; -inf if unknown.
    slow: log slowness of that passage (`speed`); nan if unknown.
    own: row of the arrival that began it; -1 if unknown.
    block: block of the image where the object left (`camtopod.topology.blocks_of`); -1 if it has no
        position.
    of: row of the departure that this one is a delayed copy of, or its own row
        (`camtopod.learn.long_paths`); a departure and its copies together have at most one arrival.
        None if there are no copies.
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
        """Return some departures; must not have delayed copies.

        kept (n,): mask of the departures.
        arrivals (m,): mask of the arrivals that are kept, by which ``own`` is renumbered.
        """
        # The new row of each arrival; the last element is for -1.
        number = np.append(np.where(arrivals, np.cumsum(arrivals) - 1, -1), -1).astype(np.int32)
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
    def without_arrivals(
        t: Floats, zone: Ints, camera: Ints, since: Floats, slow: Floats
    ) -> Departures:
        """Return departures without information about their arrivals and blocks."""
        unknown = np.full(len(t), -1, np.int32)
        return Departures(t, zone, camera, since, slow, unknown, unknown)


class Arrivals(NamedTuple):
    """Arrivals sorted by time; each column has shape (n,).

    t: time in seconds.
    zone, camera: index of the zone and of the camera.
    rate: local rate of arrivals at the zone, 1/s (`background_rate.local_rates`).
    slow: log slowness of the passage that begins (`speed`); nan if unknown.
    """

    t: Floats
    zone: Ints
    camera: Ints
    rate: Floats
    slow: Floats

    def take(self, kept: NDArray[Any]) -> Arrivals:
        """Return the arrivals ``kept``, given as a mask or as rows."""
        return Arrivals(
            self.t[kept], self.zone[kept], self.camera[kept], self.rate[kept], self.slow[kept]
        )
