"""Zones of one camera as two learners have them: which of the one's is which of the other's.

Both saw the camera's events, not exactly the same ones, and number zones as they found them. So
zones are matched by place. One that is two for the other learner stands for both.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

from camtopod.learn.zones import MATCH_DISTANCE, PLACE_SD_MIN
from camtopod.records import Zone


class Places:
    """The zones of a site by their owners' ids."""

    def __init__(self, zones: Iterable[Zone]) -> None:
        self._of_camera: dict[str, list[Zone]] = defaultdict(list)
        for zone in zones:
            self._of_camera[zone.camera].append(zone)

    def names(self, others: Iterable[Zone]) -> dict[str, list[str]]:
        """Owners' ids of what other learners call zones of theirs: the one at its place first, then
        those that have no other zone nearer. Those without any are left out.
        """
        theirs: dict[str, list[Zone]] = defaultdict(list)
        for zone in others:
            theirs[zone.camera].append(zone)
        names: dict[str, list[str]] = {}
        for camera, zones in theirs.items():
            owned = self._of_camera.get(camera, [])
            met = {zone.id: near for zone in zones if (near := nearest(zone, owned)) is not None}
            names |= {other: [zone.id] for other, zone in met.items()}
            for zone in owned:
                if all(zone.id != other.id for other in met.values()):
                    other = nearest(zone, zones)
                    if other is not None:
                        names.setdefault(other.id, []).append(zone.id)
        return names


def nearest(zone: Zone, among: Sequence[Zone]) -> Zone | None:
    """The zone at the place of another; None if there is none. A zone without positions is its
    whole camera.
    """
    if not among or zone.x is None or any(other.x is None for other in among):
        return max(among, key=lambda other: other.entries + other.exits, default=None)
    best = min(among, key=lambda other: squared_distance(zone, other))
    return best if squared_distance(zone, best) <= MATCH_DISTANCE**2 else None


def squared_distance(a: Zone, b: Zone) -> float:
    """Squared Mahalanobis distance of two zones' centres, which have positions, under the mean of
    their covariances.
    """
    (ax, ay, axx, axy, ayy), (bx, by, bxx, bxy, byy) = _figures(a), _figures(b)
    xx, xy, yy = (axx + bxx) / 2, (axy + bxy) / 2, (ayy + byy) / 2
    dx, dy = ax - bx, ay - by
    return (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)


def _figures(zone: Zone) -> tuple[float, float, float, float, float]:
    """Centre and covariance (xx, xy, yy) with `PLACE_SD_MIN`."""
    if zone.x is None or zone.y is None or zone.cov is None:
        raise ValueError(f"zone {zone.id} has no place")
    least = PLACE_SD_MIN**2
    return zone.x, zone.y, zone.cov[0][0] + least, zone.cov[0][1], zone.cov[1][1] + least
