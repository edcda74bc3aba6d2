"""Check that a topology from another program is consistent, as far as types cannot say it.

Prediction, the page, reports and exports rely on it, and on the ranges in `camtopod.records`.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator

from camtopod import sound_columns
from camtopod.records import LAG_BINS_MAX, Model, Topology

Names = Iterable[str]
OFFSET_SECONDS_MAX = 600.0
"""Largest offset that has a bin, as in `camtopod.topology.lag_bins`."""


def problems(topology: Topology) -> Iterator[str]:
    """Yield a phrase for each problem, with its place in the JSON.

    Stop at the first problem: later checks assume that the earlier ones hold.
    """
    yield from _unknown(topology)
    yield from _repeated(topology)
    yield from _shapes(topology)
    yield from _city(topology)
    if topology.model is not None:
        yield from _histograms(topology, topology.model)
        model, zones, cameras = topology.model, topology.zones, topology.cameras
        offsets = _bins(model, -OFFSET_SECONDS_MAX, OFFSET_SECONDS_MAX)
        yield from sound_columns.problems(model, zones, cameras, _lag_bins(model), offsets)


def _unknown(topology: Topology) -> Iterator[str]:
    """Check that each camera and zone that is referred to exists."""
    cameras = {camera.id for camera in topology.cameras}
    zones = {zone.id for zone in topology.zones}

    # Places with names of cameras, and places with names of zones.
    of_cameras: dict[str, Names] = {
        "zones": (zone.camera for zone in topology.zones),
        "pairs": (name for pair in topology.pairs for name in pair.cameras),
    }
    of_zones: dict[str, Names] = {
        "cameras": (name for camera in topology.cameras for name in camera.zones),
        "links": (name for link in topology.links for name in (link.from_, link.to)),
    }

    for ids, places in ((cameras, of_cameras), (zones, of_zones)):
        for place, names in places.items():
            for name in names:
                if name not in ids:
                    yield f"there is no {name!r} in it - at `$.{place}`"


def _repeated(topology: Topology) -> Iterator[str]:
    """Check that no key occurs twice."""
    keys: dict[str, list[Hashable]] = {
        "cameras": [camera.id for camera in topology.cameras],
        "zones": [zone.id for zone in topology.zones],
        "links": [(link.from_, link.to, link.relation) for link in topology.links],
        "pairs": [pair.cameras for pair in topology.pairs],
    }
    for place, entries in keys.items():
        if len(set(entries)) < len(entries):
            yield f"two items have the same key - at `$.{place}`"


def _shapes(topology: Topology) -> Iterator[str]:
    """Check zones, pairs and dwell times, each by itself."""
    camera_of = {zone.id: zone.camera for zone in topology.zones}
    if any(camera_of[zone] != camera.id for camera in topology.cameras for zone in camera.zones):
        yield "a zone is another camera's - at `$.cameras`"
    for k, zone in enumerate(topology.zones):
        if zone.id.rpartition("/")[0] != zone.camera:
            yield f"a zone's id is CAMERA/NUMBER - at `$.zones[{k}].id`"
        if (zone.x is None) != (zone.y is None):
            yield f"x and y go together - at `$.zones[{k}]`"
        if zone.cov is not None and not _is_covariance(zone.cov):
            yield f"cov is not a covariance - at `$.zones[{k}].cov`"
    for k, pair in enumerate(topology.pairs):
        if pair.cameras[0] >= pair.cameras[1]:
            yield f"the cameras are not two, sorted - at `$.pairs[{k}].cameras`"


def _city(topology: Topology) -> Iterator[str]:
    """Check the parts of a city, and that each of their cameras is in the part that owns it."""
    owners, parts = topology.owners or {}, topology.parts or []
    cameras = {part.site: {camera.id for camera in part.cameras} for part in parts}
    if len(cameras) < len(parts):
        yield "two parts are of one site - at `$.parts`"
    for k, part in enumerate(parts):
        if part.parts is not None:
            yield f"it is a city itself - at `$.parts[{k}]`"
        for camera in part.cameras:
            if camera.id not in cameras.get(owners.get(camera.id, ""), ()):
                yield f"no part owns {camera.id!r} - at `$.owners`"
        yield from (f"{problem} of `$.parts[{k}]`" for problem in problems(part))


def _is_covariance(cov: list[list[float]]) -> bool:
    (xx, xy), (yx, yy) = cov
    rounding = 1e-6 * (xx + yy) + 1e-12
    return xx >= 0 and yy >= 0 and abs(xy - yx) <= 1e-6 and xy * xy <= xx * yy + rounding


def _histograms(topology: Topology, model: Model) -> Iterator[str]:
    """Check the lag bins, and that the histograms of links lie on them."""
    first, end = _lag_bins(model)
    if not (model.lag_min < model.lag_max and end - first <= LAG_BINS_MAX):
        yield f"there are no lag bins, or more than {LAG_BINS_MAX} - at `$.model`"

    # Dwell times, of visible links, have bins of their own.
    for link in topology.links:
        histogram = link.histogram
        if histogram is None or link.relation == "visible" or not histogram.mass:
            continue
        if not first <= histogram.first <= end - len(histogram.mass):
            yield "a histogram is not on the model's lag bins - at `$.links`"


def _lag_bins(model: Model) -> tuple[int, int]:
    return _bins(model, model.lag_min, model.lag_max)


def _bins(model: Model, low: float, high: float) -> tuple[int, int]:
    """Return the first lag bin, and the one after the last, as `camtopod.topology.lag_bins`."""
    first, last = (
        math.floor(math.asinh(lag / model.lag_scale) / model.lag_step) for lag in (low, high)
    )
    return first, last + 1
