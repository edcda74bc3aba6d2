"""Check that a topology from another program is valid, beyond the types of its fields.

Prediction, the page, reports and exports rely on these checks and on the ranges of the fields
(`camtopod.records`); without them a bad topology would end in a traceback, or in a request for too
much memory.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Any

from camtopod.records import (
    CAMERA_CHARACTERS_MAX,
    LAG_BINS_MAX,
    Histogram,
    Link,
    Model,
    Topology,
)

ZONE_PATTERN = rf"^[A-Za-z0-9_.-]{{1,{CAMERA_CHARACTERS_MAX}}}/[0-9]{{1,9}}\Z"
"""Regular expression of a zone id: CAMERA/NUMBER."""
DECILES = 11
"""Number of deciles of the dwell times, minimum and maximum included."""


def problems(topology: Topology) -> Iterator[str]:
    """Yield a phrase for each problem, with its place in the JSON.

    Stop at the first problem: later checks assume that the earlier ones hold.
    """
    yield from _names(topology)
    yield from _repeated(topology)
    yield from _shapes(topology)
    if topology.model is not None:
        yield from _bins(topology.model)
        yield from _histograms(topology, topology.model)


def _names(topology: Topology) -> Iterator[str]:
    """Check that ids match their patterns, and that each zone belongs to one camera."""
    # Cameras.
    zones = {zone.id: zone.camera for zone in topology.zones}
    for k, camera in enumerate(topology.cameras):
        for zone in camera.zones:
            if zones.get(zone, camera.id) != camera.id:
                yield f"zone {zone!r} is another camera's - at `$.cameras[{k}].zones`"

    # Zones.
    for k, one in enumerate(topology.zones):
        if re.match(ZONE_PATTERN, one.id) is None or one.id.rpartition("/")[0] != one.camera:
            yield (
                f"{one.id[:CAMERA_CHARACTERS_MAX]!r} is no zone's id, which is CAMERA/NUMBER"
                f" - at `$.zones[{k}].id`"
            )

    # Pairs.
    for k, pair in enumerate(topology.pairs):
        if pair.cameras[0] >= pair.cameras[1]:
            yield f"the cameras are not two, sorted - at `$.pairs[{k}].cameras`"


def _repeated(topology: Topology) -> Iterator[str]:
    """Check that no key occurs twice."""
    # Collect the keys of the topology's items, then those of the model's.
    keyed: list[tuple[str, Iterable[Any]]] = [
        ("cameras", (camera.id for camera in topology.cameras)),
        ("zones", (zone.id for zone in topology.zones)),
        ("links", (_key_of(link) for link in topology.links)),
        ("weak_links", (_key_of(link) for link in topology.weak_links or [])),
        ("pairs", (pair.cameras for pair in topology.pairs)),
    ]
    if (model := topology.model) is not None:
        keyed += [
            ("model.zones", (zone.zone for zone in model.zones)),
            ("model.cameras", (camera.camera for camera in model.cameras)),
            ("model.onward", (row.zone for row in model.onward or [])),
            ("model.entered", ((kernel.zone, kernel.to) for kernel in model.entered or [])),
            ("model.overlaps", ((row.camera, row.to) for row in model.overlaps or [])),
        ]
        keyed += [
            (f"model.onward[{k}].next_", (o.to for o in row.next_))
            for k, row in enumerate(model.onward or [])
        ]

    # Report the first key of each list that occurs more than once.
    for place, keys in keyed:
        twice = [key for key, count in Counter(keys).items() if count > 1]
        if twice:
            yield (
                f"duplicate key {' '.join(twice[0]) if isinstance(twice[0], tuple) else twice[0]}"
                f" - at `$.{place}`"
            )


def _key_of(link: Link) -> tuple[str, str, str]:
    return link.from_, link.to, link.relation


def _shapes(topology: Topology) -> Iterator[str]:
    """Check positions and covariances of zones, and deciles of dwell times."""
    for k, zone in enumerate(topology.zones):
        if (zone.x is None) != (zone.y is None):
            yield f"x and y go together - at `$.zones[{k}]`"
        if zone.cov is not None and not _is_covariance(zone.cov):
            yield f"cov is not the covariance of positions - at `$.zones[{k}]`"

    for k, one in enumerate(topology.model.zones if topology.model is not None else []):
        if len(one.stay) not in (0, DECILES):
            yield f"stay has not {DECILES} deciles - at `$.model.zones[{k}]`"
        if any(a > b for a, b in pairwise(one.stay)):
            yield f"stay is not in ascending order - at `$.model.zones[{k}]`"


def _is_covariance(cov: list[list[float]]) -> bool:
    (xx, xy), (yx, yy) = cov
    rounding = 1e-6 * (xx + yy) + 1e-12
    return xx >= 0 and yy >= 0 and abs(xy - yx) <= 1e-6 and xy * xy <= xx * yy + rounding


def _bins(model: Model) -> Iterator[str]:
    """Check the lag bins, which are those of `camtopod.topology.lag_bins`."""
    if not model.lag_min < model.lag_max:
        yield "the range of lags is empty - at `$.model.lag_max`"
    elif _last_bin(model) - _first_bin(model) >= LAG_BINS_MAX:
        yield f"more than {LAG_BINS_MAX} lag bins - at `$.model.lag_step`"


def _first_bin(model: Model) -> int:
    return math.floor(math.asinh(model.lag_min / model.lag_scale) / model.lag_step)


def _last_bin(model: Model) -> int:
    return math.floor(math.asinh(model.lag_max / model.lag_scale) / model.lag_step)


def _histograms(topology: Topology, model: Model) -> Iterator[str]:
    """Check that the histograms lie on the model's lag bins."""
    first = _first_bin(model)
    end = _last_bin(model) + 1

    # Collect all histograms.
    held: list[tuple[str, int, Histogram | None]] = [
        ("links", k, link.histogram) for k, link in enumerate(topology.links)
    ]
    held += [("weak_links", k, link.histogram) for k, link in enumerate(topology.weak_links or [])]
    held += [
        ("model.onward", k, one.hazard)
        for k, row in enumerate(model.onward or [])
        for one in row.next_
    ]
    held += [("model.entered", k, kernel.hazard) for k, kernel in enumerate(model.entered or [])]

    # Compare their bins with the model's.
    for place, k, histogram in held:
        if histogram is None or not histogram.mass:
            continue
        if not first <= histogram.first <= end - len(histogram.mass):
            yield (
                f"a histogram that is not on the model's lag bins, {first} to {end - 1}"
                f" - at `$.{place}[{k}]`"
            )
