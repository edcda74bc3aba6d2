"""A part of those said to leave may appear again, at cameras with arrivals that nothing explains."""

from __future__ import annotations

import numpy as np
import pytest
from model_rows import CameraPath, rows_of, with_rows
from msgspec.structs import replace
from test_predictor import EXIT, any_topology, chances, link, sound

from camtopod.predict.predictor import Predictor
from camtopod.records import (
    Prediction,
)


def asked(unknown: float, seed: int = 3, after: float | None = None) -> Prediction:
    """Predict an exit at a/1, with the given part of all that leave unknown."""
    topology = any_topology(np.random.default_rng(seed))
    zones = [
        replace(zone, arrival_rate=0.01 * (1 + k)) for k, zone in enumerate(rows_of(topology).zones)
    ]
    predictor = Predictor(with_rows(topology, zones=zones))
    predictor.prepared.anywhere.unknown[:] = unknown
    now = None if after is None else EXIT.t + after
    prediction = predictor.predict(EXIT, now)
    sound(prediction)
    return prediction


@pytest.mark.parametrize("seed", range(6))
def test_the_unknown_part_is_shared_by_unexplained_arrivals_elsewhere(seed: int) -> None:
    sure, half = asked(0.0, seed), asked(0.5, seed)

    assert half.leave == pytest.approx(0.5 * sure.leave, abs=1e-3)
    more = {zone: p - chances(sure).get(zone, 0.0) for zone, p in chances(half).items()}
    assert more["c/1"] / more["b/1"] == pytest.approx(4 / 3, rel=0.01)
    assert all(abs(p) < 1e-6 for zone, p in more.items() if zone[0] == "a")


def test_no_times_are_known_of_what_may_be_anywhere() -> None:
    """Nor of fewer passages than a window has quantiles."""
    sure, half = asked(0.0), asked(0.5)
    assert not any(one.prior for one in sure.next)
    assert {one.when for one in half.next if one.prior} == {"no times known yet"}
    assert {one.camera for one in half.next if one.prior} == {"b", "c"}

    few = departing(2)
    assert few.next
    assert all(one.prior for one in few.next)


@pytest.mark.parametrize(("departures", "linked"), [(99, False), (100, False), (99, True)])
def test_where_objects_go_is_learned_by_links_or_by_many_who_left(
    departures: int, linked: bool
) -> None:
    is_learned = linked or departures >= 100
    assert departing(departures, linked).prior is not is_learned


def departing(departures: int, linked: bool = False) -> Prediction:
    """Predict an exit at a/1, from which so many objects have left."""
    topology = any_topology(np.random.default_rng(3))
    zones = [replace(zone, departures=departures) for zone in rows_of(topology).zones]
    links = [link("a/1", "b/1", 0.5, 8.0)] if linked else []
    return Predictor(replace(with_rows(topology, zones=zones), links=links)).predict(EXIT)


def test_who_has_not_come_for_long_has_left() -> None:
    lag_max = 60.0
    late = [asked(0.5, after=share * lag_max) for share in (0.1, 0.5, 0.9, 2.0)]

    ratio = [
        one.leave / asked(0.0, after=k * lag_max).leave
        for one, k in zip(late, (0.1, 0.5, 0.9, 2.0), strict=True)
    ]
    assert ratio == pytest.approx([0.55, 0.75, 0.95, 1.0], abs=2e-3)


def test_what_paths_do_not_explain_may_be_anywhere_on_a_large_site() -> None:
    """Two opinions say that all leave; of the second it is not known."""
    topology = any_topology(np.random.default_rng(3))
    rows = rows_of(topology).zones
    zones = [replace(zone, arrival_rate=1e-5, departures=900) for zone in rows]
    cameras = [*topology.cameras, *(replace(topology.cameras[0], id=f"{k}") for k in range(33))]
    unknown = []
    for paths in (None, [CameraPath("b", "c", 0.5, 300.0, 1.0)]):
        site = replace(topology, cameras=cameras, links=[])
        bare = with_rows(site, rows_of(topology), zones=zones, onward=[], contexts=[], paths=paths)
        predictor = Predictor(bare)
        unknown.append(predictor.prepared.anywhere.unknown[2])
    assert unknown[0] < 0.01
    assert 0.2 < unknown[1] < 0.4
