"""Match the zones that two districts have found in the view of one camera.

Both districts received the camera's events, but not exactly the same ones, and each numbers zones
in the order in which it finds them. So zones are matched by position. The *owner* is the district
that the camera is assigned to; a zone of the other district that is two zones of the owner stands
for both.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

from camtopod.learn.zones import MATCH_DISTANCE, PLACE_SD_MIN
from camtopod.records import Zone


class OwnedZones:
    """All zones of a site, with the ids that their owners gave them."""

    def __init__(self, zones: Iterable[Zone]) -> None:
        self._of_camera: dict[str, list[Zone]] = defaultdict(list)
        for zone in zones:
            self._of_camera[zone.camera].append(zone)

    def names(self, others: Iterable[Zone]) -> dict[str, list[str]]:
        """Return the owners' ids for the zones that another district has found, by its ids.

        others: zones of foreign cameras, as found by the other district.

        The owner's zone at the same position is first. After it come owner's zones that are not at
        the position of any other zone, and for which this zone is the nearest one. Zones without a
        match are left out.
        """
        others_of_camera: dict[str, list[Zone]] = defaultdict(list)
        for zone in others:
            others_of_camera[zone.camera].append(zone)
        names: dict[str, list[str]] = {}
        for camera, zones in others_of_camera.items():
            # For each zone, the nearest zone of the owner.
            owned = self._of_camera.get(camera, [])
            nearest_owned = {
                zone.id: near for zone in zones if (near := nearest(zone, owned)) is not None
            }
            names |= {other: [zone.id] for other, zone in nearest_owned.items()}

            # For each zone of the owner that has not been matched, the nearest of the other zones.
            for zone in owned:
                if all(zone.id != other.id for other in nearest_owned.values()):
                    other = nearest(zone, zones)
                    if other is not None:
                        names.setdefault(other.id, []).append(zone.id)
        return names


def nearest(zone: Zone, among: Sequence[Zone]) -> Zone | None:
    """Return the zone of ``among`` that is at the position of a zone; None if there is none.

    A zone without position covers the whole view; it matches the zone with the most events.
    """
    if not among or zone.x is None or any(other.x is None for other in among):
        return max(among, key=lambda other: other.entries + other.exits, default=None)
    best = min(among, key=lambda other: squared_distance(zone, other))
    return best if squared_distance(zone, best) <= MATCH_DISTANCE**2 else None


def squared_distance(a: Zone, b: Zone) -> float:
    """Return the squared Mahalanobis distance of two zones' centres under their mean covariance."""
    (ax, ay, axx, axy, ayy), (bx, by, bxx, bxy, byy) = _figures(a), _figures(b)
    xx, xy, yy = (axx + bxx) / 2, (axy + bxy) / 2, (ayy + byy) / 2
    dx, dy = ax - bx, ay - by
    return (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)


def _figures(zone: Zone) -> tuple[float, float, float, float, float]:
    """Return centre and covariance (xx, xy, yy), with the variance of `PLACE_SD_MIN` added."""
    if zone.x is None or zone.y is None or zone.cov is None:
        raise ValueError(f"zone {zone.id} has no position")
    least = PLACE_SD_MIN**2
    return zone.x, zone.y, zone.cov[0][0] + least, zone.cov[0][1], zone.cov[1][1] + least
