"""Find the zone of its camera that an event belongs to."""

from __future__ import annotations

import math
from typing import NamedTuple

from camtopod.records import Event, Zone
from camtopod.topology import GRID_COLUMNS, GRID_ROWS


class _Shape(NamedTuple):
    """A zone's weighted normal density (thesis 2.8), ready to be evaluated at a point."""

    zone: int
    x: float
    y: float
    xx: float
    two_xy: float
    yy: float
    det: float
    weight: float
    """Log of the density at the mean, up to a constant."""


class ZoneLookup:
    """The zones of a topology (indices) by camera."""

    def __init__(self, zones: list[Zone]) -> None:
        self.of_camera: dict[str, list[int]] = {}
        for k, zone in enumerate(zones):
            self.of_camera.setdefault(zone.camera, []).append(k)
        self._busiest = {
            camera: max(own, key=lambda k: zones[k].entries + zones[k].exits)
            for camera, own in self.of_camera.items()
        }
        self._shapes = {
            camera: [shape for k in own if (shape := _shape(k, zones[k])) is not None]
            for camera, own in self.of_camera.items()
        }

    def zone_of(self, event: Event) -> int | None:
        """Return the zone that an event most probably belongs to; None if its camera has none.

        Without a position it is the camera's busiest zone. A zone without a shape is chosen only if
        no zone of the camera has one.
        """
        own = self.of_camera.get(event.camera)
        if not own:
            return None
        if event.x is None or event.y is None:
            return self._busiest[event.camera]

        likeliest, most = own[0], -math.inf
        for zone, x, y, xx, two_xy, yy, det, weight in self._shapes[event.camera]:
            dx, dy = event.x - x, event.y - y
            density = weight - 0.5 * ((yy * dx * dx - two_xy * dx * dy + xx * dy * dy) / det)
            if density > most:
                likeliest, most = zone, density
        return likeliest


def _shape(k: int, zone: Zone) -> _Shape | None:
    """Return the density of a zone; None if its position is not known."""
    if zone.cov is None or zone.x is None or zone.y is None:
        return None

    # A zone may be as narrow as a line: add the variance within a grid cell, as zone learning does.
    (xx, xy), (_, yy) = zone.cov
    xx, yy = xx + 1 / (12 * GRID_COLUMNS**2), yy + 1 / (12 * GRID_ROWS**2)
    det = xx * yy - xy * xy
    weight = math.log(max(zone.entries + zone.exits, 1)) - 0.5 * math.log(det)
    return _Shape(k, zone.x, zone.y, xx, 2 * xy, yy, det, weight)
