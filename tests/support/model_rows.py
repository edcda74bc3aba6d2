"""The model of a version as rows by name, as tests write and read it.

`topology_of` makes a version of rows, which have the older form of files; `rows_of` reads the
columns of a version, without the program's own functions.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from itertools import islice
from typing import Any

import msgspec
from msgspec import Struct

from camtopod.older import with_columns
from camtopod.records import Declared, Histogram, Histograms, Link, Topology
from camtopod.topology import weak_links


class ZoneModel(Struct, frozen=True):
    zone: str
    departures: int
    arrival_rate: float
    stay: list[float]


class CameraModel(Struct, frozen=True):
    camera: str
    share: float
    last_event: float


class Outcome(Struct, frozen=True):
    to: str
    share: float
    hazard: Histogram
    doubt: float = 0.0
    missed: bool = False


class Onward(Struct, frozen=True):
    zone: str
    leave: float
    next_: list[Outcome]


class EntryKernel(Struct, frozen=True):
    zone: str
    to: str
    hazard: Histogram


class Context(Struct, frozen=True):
    zone: str
    departures: float
    to: dict[str, float]
    entry: str | None = None
    block: int | None = None
    previous: str | None = None


class Way(Struct, frozen=True):
    entry: str
    exit: str
    stay: float


class Pace(Struct, frozen=True):
    scaling: float
    correlation: float
    sd: float
    ways: list[Way]


class LabelModel(Struct, frozen=True):
    names: list[str]
    persistence: float
    shares: dict[str, list[float]]


class Overlap(Struct, frozen=True):
    camera: str
    to: str
    share: float
    same: Histogram
    others: Histogram


class CameraPath(Struct, frozen=True, rename={"from_": "from"}):
    from_: str
    to: str
    share: float
    place: float
    width: float


class Model(Struct, frozen=True, omit_defaults=True):
    lag_scale: float
    lag_step: float
    lag_min: float
    lag_max: float
    zones: list[ZoneModel]
    cameras: list[CameraModel]
    clocks_corrected: bool = False
    onward: list[Onward] | None = None
    entered: list[EntryKernel] | None = None
    contexts: list[Context] | None = None
    pace: Pace | None = None
    overlaps: list[Overlap] | None = None
    paths: list[CameraPath] | None = None
    declared: Declared | None = None
    labels: LabelModel | None = None


def with_rows(
    topology: Topology,
    model: Model | None = None,
    weak: Sequence[Link] | None = None,
    **fields: Any,
) -> Topology:
    """Return a version with another model, with some of its fields replaced, or other weak links.

    Without a model or fields, the rows of the version itself are taken.
    """
    rows = msgspec.structs.replace(model or rows_of(topology), **fields)
    content = msgspec.to_builtins(topology) | {"model": msgspec.to_builtins(rows)}
    content["weak_links"] = msgspec.to_builtins(weak_links(topology) if weak is None else weak)
    return msgspec.convert(with_columns(content), Topology)


def column(raw: bytes, kind: str) -> list[Any]:
    """Return the numbers of a column; kind as in `struct`, such as ``f``."""
    plain = zlib.decompress(raw) if raw else b""
    return [one for (one,) in struct.iter_unpack(f"<{kind}", plain)]


def rows_of(topology: Topology) -> Model:
    """Return the model of a version as rows."""
    m, zones = topology.model, [zone.id for zone in topology.zones]
    assert m is not None
    cameras = [camera.id for camera in topology.cameras]
    stay = column(m.stay, "f") or [0.0] * 11 * len(zones)
    by_zone = zip(
        zones,
        column(m.departures, "i") or [0] * len(zones),
        column(m.arrival_rate, "f") or [0.0] * len(zones),
        (
            [*stay[11 * k : 11 * k + 11]] if any(stay[11 * k : 11 * k + 11]) else []
            for k in range(len(zones))
        ),
        strict=True,
    )
    by_camera = zip(
        cameras,
        column(m.event_share, "f") or [0.0] * len(cameras),
        column(m.last_event, "d") or [0.0] * len(cameras),
        strict=True,
    )
    return Model(
        m.lag_scale,
        m.lag_step,
        m.lag_min,
        m.lag_max,
        [ZoneModel(*row) for row in by_zone],
        [CameraModel(*row) for row in by_camera],
        m.clocks_corrected,
        onward=_onward(m, zones),
        entered=_entered(m, zones),
        contexts=_contexts(m, zones, cameras),
        pace=_pace(m, zones),
        overlaps=_overlaps(m, cameras),
        paths=_paths(m, zones, cameras),
        declared=m.declared,
        labels=_labels(m, zones),
    )


def histograms(columns: Histograms, delay: Sequence[float] = ()) -> list[Histogram]:
    steps = iter(column(columns.steps, "B"))
    bins, unit = column(columns.bins, "h"), column(columns.unit, "f")
    delays = [*delay, *[0.0] * (len(bins) - len(delay))]
    return [
        Histogram(first, [scale * step for step in islice(steps, length)], delay=late)
        for first, length, scale, late in zip(
            column(columns.first, "h"), bins, unit, delays, strict=True
        )
    ]


def _onward(m: Any, zones: list[str]) -> list[Onward] | None:
    if m.onward is None:
        return None
    rows = zip(
        [zones[k] for k in column(m.onward.to, "i")],
        column(m.onward.share, "f"),
        histograms(m.onward.hazard, column(m.onward.delay, "f")),
        column(m.onward.doubt, "f"),
        [bool(one) for one in column(m.onward.missed, "B")],
        strict=True,
    )
    leave, number = column(m.onward.leave, "f"), column(m.onward.number, "i")
    return [
        Onward(zone, gone, [Outcome(*row) for row in islice(rows, count)])
        for zone, gone, count in zip(zones, leave, number, strict=True)
    ]


def _entered(m: Any, zones: list[str]) -> list[EntryKernel] | None:
    if m.entered is None:
        return None
    ends = ([zones[k] for k in column(raw, "i")] for raw in (m.entered.zone, m.entered.to))
    return [EntryKernel(*row) for row in zip(*ends, histograms(m.entered.hazard), strict=True)]


def _contexts(m: Any, zones: list[str], cameras: list[str]) -> list[Context] | None:
    if (c := m.contexts) is None:
        return None
    to = iter(zip([zones[k] for k in column(c.to, "i")], column(c.transitions, "f"), strict=True))
    of_zone = [
        zone
        for zone, number in zip(zones, column(c.number, "i"), strict=True)
        for _ in range(number)
    ]
    columns = (column(c.entry, "i"), column(c.block, "i"), column(c.previous, "i"))
    return [
        Context(
            zone,
            departures,
            dict(islice(to, followed)),
            None if entry < 0 else zones[entry],
            None if block < 0 else block,
            None if previous < 0 else cameras[previous],
        )
        for zone, departures, followed, entry, block, previous in zip(
            of_zone, column(c.departures, "f"), column(c.followed, "h"), *columns, strict=True
        )
    ]


def _pace(m: Any, zones: list[str]) -> Pace | None:
    if m.pace is None:
        return None
    ends = ([zones[k] for k in column(raw, "i")] for raw in (m.pace.entry, m.pace.exit))
    ways = [Way(*row) for row in zip(*ends, column(m.pace.stay, "f"), strict=True)]
    return Pace(m.pace.scaling, m.pace.correlation, m.pace.sd, ways)


def _overlaps(m: Any, cameras: list[str]) -> list[Overlap] | None:
    if m.overlaps is None:
        return None
    ends = ([cameras[k] for k in column(raw, "i")] for raw in (m.overlaps.camera, m.overlaps.to))
    both = (histograms(m.overlaps.same), histograms(m.overlaps.others))
    return [Overlap(*row) for row in zip(*ends, column(m.overlaps.share, "f"), *both, strict=True)]


def _paths(m: Any, zones: list[str], cameras: list[str]) -> list[CameraPath] | None:
    if m.paths is None:
        return None
    names = zones if m.paths.of_zones else cameras
    ends = ([names[k] for k in column(raw, "i")] for raw in (m.paths.from_, m.paths.to))
    figures = (column(raw, "f") for raw in (m.paths.share, m.paths.place, m.paths.width))
    return [CameraPath(*row) for row in zip(*ends, *figures, strict=True)]


def _labels(m: Any, zones: list[str]) -> LabelModel | None:
    if m.labels is None:
        return None
    names = m.labels.names
    rows = zip(*[iter(column(m.labels.shares, "f"))] * len(names), strict=True)
    shares = {zone: list(row) for zone, row in zip(zones, rows, strict=True)}
    return LabelModel(names, m.labels.persistence, shares)
