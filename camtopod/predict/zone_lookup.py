"""Find the zone that an event belongs to, by its camera and position (thesis 2.8).

Each zone of the topology is a Gaussian; an event belongs to the zone with the largest weighted
density at its position. In contrast to learning, no event counts as clutter, so that a prediction
is possible for every exit.
"""

from __future__ import annotations

import math

from camtopod.records import Event, Zone
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

_Shape = tuple[int, float, float, float, float, float, float, float]
"""A zone's weighted normal density, prepared for evaluation at a point: index of the zone; mean x
and y, image units; covariance xx, twice xy, yy, and its determinant; log of the weighted density at
the mean, up to a constant.
"""


class ZoneLookup:
    """Finds the zones of events; zones are indices into ``zones``."""

    def __init__(self, zones: list[Zone]) -> None:
        self.of_camera: dict[str, list[int]] = {}
        for k, zone in enumerate(zones):
            self.of_camera.setdefault(zone.camera, []).append(k)
        self._zones = zones
        self._shapes: dict[str, list[_Shape]] = {}
        """By camera that was asked for."""

    def zone_of(self, event: Event) -> int | None:
        """Return the zone that an event most probably belongs to; None if its camera has no zones.

        An event without a position belongs to the camera's busiest zone. A zone of unknown position
        is chosen only if no zone of the camera has a known one.
        """
        camera_zones = self.of_camera.get(event.camera)
        if not camera_zones:
            return None
        if event.x is None or event.y is None:
            return max(camera_zones, key=lambda k: self._zones[k].entries + self._zones[k].exits)

        shapes = self._shapes.get(event.camera)
        if shapes is None:
            every_shape = (_shape(k, self._zones[k]) for k in camera_zones)
            shapes = [shape for shape in every_shape if shape is not None]
            self._shapes[event.camera] = shapes
        likeliest = camera_zones[0]
        density_max = -math.inf
        for zone, x, y, xx, two_xy, yy, det, weight in shapes:
            dx = event.x - x
            dy = event.y - y
            density = weight - 0.5 * ((yy * dx * dx - two_xy * dx * dy + xx * dy * dy) / det)
            if density > density_max:
                likeliest = zone
                density_max = density
        return likeliest


def _shape(k: int, zone: Zone) -> _Shape | None:
    """Return the density of a zone with index ``k``; None if the zone has no position."""
    if zone.cov is None or zone.x is None or zone.y is None:
        return None

    # A zone may be as narrow as a line: add the variance within a grid cell, as zone learning does.
    (xx, xy), (_, yy) = zone.cov
    xx = xx + 1 / (12 * GRID_COLUMNS**2)
    yy = yy + 1 / (12 * GRID_ROWS**2)
    det = xx * yy - xy * xy
    weight = math.log(max(zone.entries + zone.exits, 1)) - 0.5 * math.log(det)
    return k, zone.x, zone.y, xx, 2 * xy, yy, det, weight
