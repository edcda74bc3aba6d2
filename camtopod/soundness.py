"""Check that a topology from another program is valid: names, ranges, shapes and sizes.

Prediction, the page, reports and exports rely on these checks; without them a bad topology would
end in a traceback, or in a request for too much memory. The ranges are those of any possible site,
not of a likely one.
"""

from __future__ import annotations

import functools
import math
import re
import types
import typing
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import msgspec
from msgspec import Struct

from camtopod.records import (
    CAMERA_CHARACTERS_MAX,
    CAMERA_PATTERN,
    Alarm,
    Camera,
    CameraModel,
    ChainEdge,
    Context,
    Histogram,
    Lacks,
    Link,
    Model,
    Onward,
    Outcome,
    Pace,
    SelfScore,
    Topology,
    Transit,
    Way,
    Zone,
    ZoneModel,
)

ZONE_PATTERN = rf"^[A-Za-z0-9_.-]{{1,{CAMERA_CHARACTERS_MAX}}}/[0-9]{{1,9}}\Z"
"""Regular expression of a zone id: CAMERA/NUMBER."""
PLACE_PATTERN = rf"^[A-Za-z0-9_.-]{{1,{CAMERA_CHARACTERS_MAX}}}(/[0-9]{{1,9}})?\Z"
"""Regular expression of a camera or a zone."""
LAG_BINS_MAX = 1_000
"""Most lag bins that a model may have; learned topologies have about 90."""
DECILES = 11
"""Number of deciles of the dwell times, minimum and maximum included."""
_COUNT = (0, 2**53)
_NUMBER = (0.0, 1e15)
_SHARE = (0.0, 1.001)
"""Range of a share; the upper end allows for rounding."""
_TIME = (-1e11, 1e11)
"""Range of a time since 1970, or of a lag, in seconds."""
_SPAN = (0.0, 1e11)
"""Range of a duration, in seconds."""
Ranges = dict[str, tuple[float, float]]
_RANGES: dict[type[Struct], Ranges] = {
    Topology: {"version": _COUNT, "events": _COUNT, "as_of": _TIME},
    Camera: {"clock_offset": _TIME, "clock_offset_sd": _SPAN},
    Zone: {"entries": _COUNT, "exits": _COUNT, "x": _SHARE, "y": _SHARE},
    Link: {
        "probability": _SHARE,
        "transitions": _NUMBER,
        "q_value": _SHARE,
        "mahalanobis_variance": _NUMBER,
    },
    Lacks: {"passages": _NUMBER, "seconds": _SPAN},
    Transit: dict.fromkeys(("mode", "mean", "q10", "q50", "q90"), _TIME)
    | dict.fromkeys(("sd", "mean_sd", "q50_sd"), _SPAN),
    Histogram: {"unit": _NUMBER, "delay": _SPAN},
    Model: {
        "lag_scale": (1e-3, 1e6),
        "lag_step": (1e-4, 10.0),
        "lag_min": (-1e6, 1e6),
        "lag_max": (-1e6, 1e6),
    },
    ZoneModel: {"departures": _COUNT, "arrival_rate": _NUMBER},
    CameraModel: {"share": _SHARE, "last_event": _TIME},
    Onward: {"leave": _SHARE},
    Outcome: {"share": _SHARE, "doubt": _SHARE},
    Context: {"departures": _NUMBER, "block": _COUNT},
    Pace: {"scaling": (0.0, 10.0), "correlation": (-1.0, 1.0), "sd": (0.0, 10.0)},
    Way: {"stay": (1e-6, 1e11)},
    ChainEdge: {"probability": _SHARE},
    Alarm: {"version": _COUNT, "t": _TIME},
    SelfScore: {"exits": _COUNT, "since_version": _COUNT}
    | dict.fromkeys(("log_loss", "baseline_log_loss"), _NUMBER)
    | dict.fromkeys(("top1", "top3", "baseline_top1"), _SHARE),
}
"""Smallest and largest value of the numeric fields of each struct; None is always allowed."""


def problems(topology: Topology) -> Iterator[str]:
    """Yield a phrase for each problem, with its place in the JSON.

    Stop at the first problem: later checks assume that the earlier ones hold.
    """
    yield from _names(topology)
    yield from _repeated(topology)
    yield from _walk(topology, "")
    if topology.model is not None:
        yield from _bins(topology.model)
        yield from _histograms(topology, topology.model)


def _names(topology: Topology) -> Iterator[str]:
    """Check that ids match their patterns, and that each zone belongs to one camera."""
    # Cameras.
    zones = {zone.id: zone.camera for zone in topology.zones}
    for k, camera in enumerate(topology.cameras):
        if re.match(CAMERA_PATTERN, camera.id) is None:
            yield (
                f"{camera.id[:CAMERA_CHARACTERS_MAX]!r} is no camera's id - at `$.cameras[{k}].id`"
            )
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
    """Check that no item is there twice."""
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
                f"{' '.join(twice[0]) if isinstance(twice[0], tuple) else twice[0]} is there twice"
                f" - at `$.{place}`"
            )


def _key_of(link: Link) -> tuple[str, str, str]:
    return link.from_, link.to, link.relation


def _walk(one: Struct, place: str) -> Iterator[str]:
    """Check the ranges and shapes of a struct and of all structs in it."""
    kind = type(one)
    for name, (low, high) in _RANGES.get(kind, {}).items():
        value = getattr(one, name)
        if value is not None and not low <= value <= high:
            yield f"{name} is not between {low:g} and {high:g} - at `$.{place}{name}`"
    if (shape := _SHAPES.get(kind)) is not None and (what := shape(one)):
        yield f"{what} - at `$.{place.removesuffix('.')}`"
    for name in _inner(kind):
        inner = getattr(one, name)
        if isinstance(inner, Struct):
            yield from _walk(inner, f"{place}{name}.")
        elif inner:
            for k, item in enumerate(inner):
                yield from _walk(item, f"{place}{name}[{k}].")


def _zone_shape(zone: Zone) -> str:
    if (zone.x is None) != (zone.y is None):
        return "x and y go together"
    if zone.cov is None:
        return ""
    if [len(row) for row in zone.cov] != [2, 2]:
        return "cov is not 2 by 2"
    (xx, xy), (yx, yy) = zone.cov
    rounded = 1e-6 * (xx + yy) + 1e-12
    if not (
        0 <= xx <= 1 and 0 <= yy <= 1 and abs(xy - yx) <= 1e-6 and xy * xy <= xx * yy + rounded
    ):
        return "cov is not the covariance of positions"
    return ""


def _histogram_shape(histogram: Histogram) -> str:
    if len(histogram.mass) > LAG_BINS_MAX:
        return f"more than {LAG_BINS_MAX} bins"
    if not all(0.0 <= mass <= 1e15 for mass in histogram.mass):
        return "mass is not between 0 and 1e+15"
    return ""


def _stay_shape(zone: ZoneModel) -> str:
    low, high = _SPAN
    if len(zone.stay) not in (0, DECILES):
        return f"stay has not {DECILES} deciles"
    if not all(low <= a <= b <= high for a, b in zip(zone.stay, zone.stay[1:], strict=False)):
        return "stay is not in ascending order"
    return ""


def _context_shape(context: Context) -> str:
    low, high = _NUMBER
    return (
        ""
        if all(low <= number <= high for number in context.to.values())
        else "to has no number of departures"
    )


_SHAPES: dict[type[Struct], Callable[[Any], str]] = {
    Zone: _zone_shape,
    Histogram: _histogram_shape,
    ZoneModel: _stay_shape,
    Context: _context_shape,
}


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
    first, end = _first_bin(model), _last_bin(model) + 1

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


@functools.cache
def _inner(kind: type[Struct]) -> list[str]:
    """Return the names of the fields that hold structs."""
    return [
        field.name
        for field in msgspec.structs.fields(kind)
        if any(_is_noun(one) for one in _types(field.type))
    ]


def _types(given: Any) -> Iterator[Any]:
    """Yield the types of which a field's type consists."""
    if isinstance(given, types.UnionType) or typing.get_origin(given) is list:
        for one in typing.get_args(given):
            yield from _types(one)
    else:
        yield given


def _is_noun(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Struct)
