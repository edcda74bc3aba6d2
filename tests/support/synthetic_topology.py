"""A synthetic topology of any size, as a learner would publish it."""

from __future__ import annotations

import functools
import math
import random

from model_rows import CameraModel, Model, ZoneModel, with_rows

from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Alarm,
    Camera,
    Histogram,
    Link,
    Pair,
    SelfScore,
    Topology,
    Transit,
    Zone,
)
from camtopod.topology.lag_bins import LagBins
from camtopod.topology.versions import with_digest

AS_OF = 1_700_003_600.0
BINS = LagBins(-120.0, 180.0)
CORNERS = ((0.1, 0.5), (0.9, 0.5), (0.5, 0.1), (0.5, 0.9))
OPPOSITE = (1, 0, 3, 2)
SHARE = 0.45


def synthetic_topology(
    cameras: int, seed: int = 1, version: int = 1, as_of: float = AS_OF
) -> Topology:
    """Return a site on a grid with streets missing.

    There is a zone on each side that leads somewhere, and a link in each direction across a street.
    """
    chance = random.Random(seed)
    side = math.ceil(math.sqrt(1.6 * cameras))
    names = [f"cam{k:04d}" for k in range(cameras)]
    streets = [
        (k, other, way)
        for k in range(cameras)
        for other, way in ((k + 1, 1), (k + side, 3))
        if other < cameras and (way == 3 or (k + 1) % side) and chance.random() < 0.75
    ]
    sides: dict[int, set[int]] = {k: set() for k in range(cameras)}
    for a, b, way in streets:
        sides[a].add(way)
        sides[b].add(OPPOSITE[way])
    zones = [
        _zone(names[k], way, chance) for k in range(cameras) for way in sorted(sides[k] or {0})
    ]  # a camera without streets has one zone
    exits = {zone.id: zone.exits for zone in zones}
    zones_of: dict[str, list[str]] = {name: [] for name in names}
    for zone in zones:
        zones_of[zone.camera].append(zone.id)
    links, pairs = [], []
    for a, b, way in streets:
        overlapped = chance.random() < 0.2
        ends = f"{names[a]}/{way + 1}", f"{names[b]}/{OPPOSITE[way] + 1}"
        for from_, to in (ends, ends[::-1]):
            middle = -1.5 if overlapped else chance.uniform(3, 60)
            links.append(made_link(from_, to, middle, SHARE * exits[from_], overlapped))
        pairs.append(Pair((names[a], names[b]), "overlapped" if overlapped else "unseen_path"))
    for camera in range(cameras):
        for one in sides[camera]:
            for other in sides[camera] - {one}:
                ends = f"{names[camera]}/{one + 1}", f"{names[camera]}/{other + 1}"
                links.append(made_link(*ends, 9.0, 80.0, False, visible=True))
    plain = Topology(
        TOPOLOGY_SCHEMA,
        "mall",
        "01J",
        version,
        as_of,
        400 * cameras,
        "",
        [Camera(name, zones_of[name], 0.0, 0.1) for name in names],
        zones,
        sorted(links, key=lambda x: (x.from_, x.to, x.relation)),
        pairs,
        alarms=[Alarm(version, as_of, "camera_silent", names[0], "no event since 02:10")],
        score=SelfScore(200, 1, 1.1, 0.75, 0.91, 1.6, 0.55),
    )
    return with_digest(with_rows(plain, _model(names, zones, as_of), []))


def made_link(
    from_: str,
    to: str,
    middle: float,
    transitions: float,
    overlapped: bool = False,
    visible: bool = False,
) -> Link:
    """Return a link with a bell-shaped histogram about ``middle`` seconds."""
    sd = 0.5 + 0.15 * abs(middle)
    transit = Transit(middle, middle, sd, middle - 1.28 * sd, middle, middle + 1.28 * sd, 0.1, 0.1)
    relation = "visible" if visible else "overlapped" if overlapped else "unseen"
    histogram = _histogram(middle, sd, transitions)
    return Link(from_, to, relation, SHARE, round(transitions, 1), transit, 1e-12, 0.02, histogram)  # type: ignore[arg-type]


@functools.lru_cache(maxsize=16)
def _histogram(middle: float, sd: float, transitions: float) -> Histogram:
    """Return a bell; those of visible links are all the same."""
    bell = [
        math.exp(-0.5 * ((x - middle) / sd) ** 2) * w
        for x, w in zip(BINS.centres.tolist(), BINS.widths.tolist(), strict=True)
    ]
    kept = [k for k, value in enumerate(bell) if value > 0.01 * max(bell)]
    mass = [round(transitions * bell[k] / sum(bell), 2) for k in kept]
    return Histogram(BINS.first + kept[0], mass)


def _zone(camera: str, way: int, chance: random.Random) -> Zone:
    x, y = (value + chance.uniform(-0.05, 0.05) for value in CORNERS[way])
    traffic = int(chance.lognormvariate(5.5, 0.8))
    return Zone(
        f"{camera}/{way + 1}", camera, traffic, traffic, x, y, [[0.002, 0.0005], [0.0005, 0.001]]
    )


def _model(names: list[str], zones: list[Zone], as_of: float) -> Model:
    models = [ZoneModel(zone.id, zone.exits, 0.002, []) for zone in zones]
    cameras = [CameraModel(name, 1 / len(names), as_of) for name in names]
    return Model(BINS.scale, BINS.step, BINS.lag_min, BINS.lag_max, models, cameras)
