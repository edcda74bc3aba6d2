"""How the map grew: cameras and related pairs of earlier versions, as the daemon has kept them."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TypeVar

from msgspec import Struct

from camtopod import codec
from camtopod.records import PairRelation, Topology
from camtopod.serve.bus import Bus, QueryError
from camtopod.serve.city_bus import CityBus

STEPS_MAX = 40
"""Versions that are shown, evenly among all."""

_T = TypeVar("_T")


class Step(Struct, frozen=True):
    """What the map of a version had; ``pairs`` by the two camera ids, separated by a space."""

    version: int
    as_of: float
    cameras: list[str]
    pairs: dict[str, PairRelation]


def step(topology: Topology) -> Step:
    """Return what the map of a version has."""
    pairs = {" ".join(sorted(pair.cameras)): pair.relation for pair in topology.pairs}
    return Step(topology.version, topology.as_of, [camera.id for camera in topology.cameras], pairs)


def thinned(versions: Sequence[_T]) -> list[_T]:
    """Return at most `STEPS_MAX` of the versions, evenly, with the first and the last."""
    count = min(STEPS_MAX, len(versions))
    return [versions[round(k * (len(versions) - 1) / max(1, count - 1))] for k in range(count)]


def steps(bus: Bus | CityBus, newest: Topology) -> list[Step]:
    """Return the steps to the newest version; those that the daemon has not kept are missing.

    It takes as long as the daemon needs to read up to `STEPS_MAX` versions. If it does not answer,
    no further version is asked for.
    """
    result = []
    for version in thinned(range(1, newest.version)):
        parameters = {"epoch": newest.epoch, "version": version}
        with contextlib.suppress(QueryError, codec.Rejected):
            answers = bus.query("topology", parameters, one=True)
            if not answers:
                break
            result.append(step(codec.decode_topology(answers[0][1], pack=True)))
    return [*result, step(newest)]
