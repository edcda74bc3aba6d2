"""Check that a topology from another program is consistent, as far as types cannot say it.

Prediction, the page, reports and exports rely on it, and on the ranges in `camtopod.records`.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator
from itertools import pairwise

from camtopod.records import LAG_BINS_MAX, Histogram, Model, Topology

Names = Iterable[str]


def problems(topology: Topology) -> Iterator[str]:
    """Yield a phrase for each problem, with its place in the JSON.

    Stop at the first problem: later checks assume that the earlier ones hold.
    """
    yield from _unknown(topology)
    yield from _repeated(topology)
    yield from _shapes(topology)
    if topology.model is not None:
        yield from _histograms(topology, topology.model)


def _unknown(topology: Topology) -> Iterator[str]:
    """Check that each camera and zone that is referred to exists."""
    cameras = {camera.id for camera in topology.cameras}
    zones = {zone.id for zone in topology.zones}

    # Places with names of cameras, and places with names of zones.
    of_cameras: dict[str, Names] = {
        "zones": (zone.camera for zone in topology.zones),
        "pairs": (name for pair in topology.pairs for name in pair.cameras),
        "model.paths": (
            name
            for path in (topology.model.paths if topology.model is not None else None) or []
            for name in (path.from_, path.to)
            if name not in zones
        ),
    }
    links = {"links": topology.links, "weak_links": topology.weak_links or []}
    of_zones: dict[str, Names] = {
        "cameras": (name for camera in topology.cameras for name in camera.zones),
        **{
            place: (name for link in place_links for name in (link.from_, link.to))
            for place, place_links in links.items()
        },
    }
    if topology.model is not None:
        of_zones |= _zones_of(topology.model)

    for ids, places in ((cameras, of_cameras), (zones, of_zones)):
        for place, names in places.items():
            for name in names:
                if name not in ids:
                    yield f"there is no {name!r} in it - at `$.{place}`"


def _zones_of(model: Model) -> dict[str, Names]:
    """Return the zones that prediction looks up, by their place in the JSON."""
    contexts = model.contexts or []
    ways = model.pace.ways if model.pace is not None else []
    shares = model.labels.shares if model.labels else {}
    return {
        "model.zones": (row.zone for row in model.zones),
        "model.onward": (
            name
            for row in model.onward or []
            for name in (row.zone, *(outcome.to for outcome in row.next_))
        ),
        "model.entered": (name for row in model.entered or [] for name in (row.zone, row.to)),
        "model.contexts": (name for row in contexts for name in (row.zone, *row.to)),
        "model.contexts.entry": (row.entry for row in contexts if row.entry is not None),
        "model.pace.ways": (name for way in ways for name in (way.entry, way.exit)),
        "model.labels.shares": shares,
    }


def _repeated(topology: Topology) -> Iterator[str]:
    """Check that no key occurs twice."""
    keys: dict[str, list[Hashable]] = {
        "cameras": [camera.id for camera in topology.cameras],
        "zones": [zone.id for zone in topology.zones],
        "links": [(link.from_, link.to, link.relation) for link in topology.links],
        "weak_links": [(link.from_, link.to, link.relation) for link in topology.weak_links or []],
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
    labels = topology.model.labels if topology.model is not None else None
    if labels and any(len(row) != len(labels.names) for row in labels.shares.values()):
        yield "a zone has not as many shares as there are names - at `$.model.labels`"
    for k, row in enumerate(topology.model.zones if topology.model is not None else []):
        if any(a > b for a, b in pairwise(row.stay)):
            yield f"stay is not in ascending order - at `$.model.zones[{k}]`"


def _is_covariance(cov: list[list[float]]) -> bool:
    (xx, xy), (yx, yy) = cov
    rounding = 1e-6 * (xx + yy) + 1e-12
    return xx >= 0 and yy >= 0 and abs(xy - yx) <= 1e-6 and xy * xy <= xx * yy + rounding


def _histograms(topology: Topology, model: Model) -> Iterator[str]:
    """Check the lag bins, and that the histograms lie on them."""
    # As `camtopod.topology.lag_bins`.
    first = math.floor(math.asinh(model.lag_min / model.lag_scale) / model.lag_step)
    end = math.floor(math.asinh(model.lag_max / model.lag_scale) / model.lag_step) + 1
    if not (model.lag_min < model.lag_max and end - first <= LAG_BINS_MAX):
        yield f"there are no lag bins, or more than {LAG_BINS_MAX} - at `$.model`"

    # Dwell times, of visible links, have bins of their own.
    between = (link for link in topology.links if link.relation != "visible")
    histograms: dict[str, Iterable[Histogram | None]] = {
        "links": (link.histogram for link in between),
        "weak_links": (link.histogram for link in topology.weak_links or []),
        "model.onward": (outcome.hazard for row in model.onward or [] for outcome in row.next_),
        "model.entered": (kernel.hazard for kernel in model.entered or []),
    }
    for place, group in histograms.items():
        for histogram in group:
            if (
                histogram is not None
                and histogram.mass
                and not first <= histogram.first <= end - len(histogram.mass)
            ):
                yield f"a histogram is not on the model's lag bins - at `$.{place}`"
