"""Tables of departures and arrivals: the exits and entries of the window, by column.

A fit finds which arrival is of the same object as which departure. Zones are numbered over the
whole site, cameras as in the window.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints, Singles

EVENT_SD_SECONDS = 0.25
"""Least standard deviation of times between two events: cameras do not tell them more exactly."""


class Departures(NamedTuple):
    """Departures (exits from zones) sorted by time; each column has shape (n,).

    t: time of the exit in seconds.
    zone, camera: index of the zone and of the camera.
    since: time in seconds of the entry into the view that the object now leaves; -inf if unknown.
    slow: slowness of the passage that ends with this departure (`speed`); nan if unknown.
    own: row in the table of arrivals of the entry that began this passage; -1 if unknown.
    block: block of the image where the object left (`camtopod.topology.blocks_of`); -1 if the exit
        has no position.
    label: number of the object's label (`labels`), negative if unknown; None without labels.
    """

    t: Floats
    zone: Ints
    camera: Ints
    since: Floats
    slow: Floats
    own: Ints
    block: Ints
    label: Ints | None = None

    def take(self, mask: NDArray[np.bool_], arrivals: NDArray[np.bool_]) -> Departures:
        """Return the departures of a mask.

        mask (n,): mask of the departures to keep.
        arrivals (m,): mask of the arrivals that are kept, too; the column ``own`` is renumbered
            accordingly.
        """
        # The new row of each arrival; the last element is for -1.
        number = np.append(np.where(arrivals, np.cumsum(arrivals) - 1, -1), -1).astype(np.int32)
        return self._replace(own=number[self.own])._rows(mask)

    def passages(self) -> Departures:
        """Return the departures that end a passage whose entry is known and in a zone."""
        return self._rows(self.own >= 0)

    def _rows(self, mask: NDArray[np.bool_]) -> Departures:
        columns: list[Any] = [None if column is None else column[mask] for column in self]
        return Departures(*columns)

    @staticmethod
    def without_arrivals(
        t: Floats, zone: Ints, camera: Ints, since: Floats, slow: Floats
    ) -> Departures:
        """Return departures from the given columns, with ``own`` and ``block`` unknown."""
        unknown = np.full(len(t), -1, np.int32)
        return Departures(t, zone, camera, since, slow, unknown, unknown)


class Arrivals(NamedTuple):
    """Arrivals (entries into zones) sorted by time; each column has shape (n,).

    t: time of the entry in seconds.
    zone, camera: index of the zone and of the camera.
    rate: rate of arrivals at the zone at this time under the null model, 1/s (`background_rate`,
        `rhythm`).
    slow: slowness of the passage that begins with this arrival (`speed`); nan if unknown.
    weight: rate without rhythm over ``rate``; None if there is no rhythm. A platoon of arrivals
        counts as much as one arrival at any time.
    label: as that of departures.
    label_share: share of the label among the arrivals at the zone (`labels`); None without labels.
    """

    t: Floats
    zone: Ints
    camera: Ints
    rate: Floats
    slow: Floats
    weight: Floats | None = None
    label: Ints | None = None
    label_share: Floats | None = None

    def take(self, rows: NDArray[Any]) -> Arrivals:
        """Return the arrivals ``rows``, given as a mask or as rows."""
        columns: list[Any] = [None if column is None else column[rows] for column in self]
        return Arrivals(*columns)

    def weights(self, rows: Indices) -> Singles:
        """Return the weights (k,) of some arrivals in the excess over the null model.

        rows (k,): the arrivals.
        """
        if self.weight is None:
            return np.ones(len(rows), np.float32)
        return self.weight.astype(np.float32).take(rows)
