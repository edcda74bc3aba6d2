"""The prediction model of a version: posterior, later changes, without negligible parts."""

from __future__ import annotations

import numpy as np
import pytest
from model_rows import rows_of
from scipy.sparse import csr_array
from synthetic_events import Views, fit_posterior

from camtopod.learn.association.problem import Problem
from camtopod.learn.changes.change_points import ChangePoint
from camtopod.learn.links import MissedTransitions
from camtopod.learn.next_camera.fit import Posterior
from camtopod.learn.prediction_model import NEXT_ZONES_MAX, build_model
from camtopod.learn.traffic.labelled_events import Scene, ZoneRef
from camtopod.learn.window.sliding_window import Window
from camtopod.predict.hazards import Hazards
from camtopod.predict.predictor import Predictor
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Camera,
    Event,
    Topology,
    Zone,
)
from camtopod.topology.histograms import masses_on_bins
from camtopod.topology.lag_bins import LagBins

BINS = LagBins(-20.0, 120.0)
NAMES = ["a", "b", "c"]


@pytest.fixture(scope="module")
def learned() -> tuple[Scene, Posterior]:
    """Learn a site where six in ten go from a to b, 8 s after the exit, and three in ten to c.

    All have a known block and entry.
    """
    rng = np.random.default_rng(0)
    views = Views([0, 1, 2])
    for t in rng.uniform(0, 40_000, 800):
        views.through(t, t + 4, 0, 0, block=5)
        if (dice := rng.random()) < 0.9:
            zone = 1 if dice < 0.6 else 2
            views.through(t + 4 + rng.normal(8, 1), t + 20, zone, zone, block=9)
    departures, arrivals = views.columns()
    scene = Scene(
        [ZoneRef(k, 1, None) for k in range(3)],
        departures,
        arrivals,
        np.bincount(arrivals.zone, minlength=3),
        np.bincount(departures.zone, minlength=3),
        np.ones(3, bool),
        0.0,
        float(departures.t[-1]),
    )
    return scene, fit_posterior(Problem(departures, arrivals, BINS, 3, scene.last))


def made(
    learned: tuple[Scene, Posterior | None],
    changes: list[ChangePoint] | None = None,
    missed: MissedTransitions | None = None,
) -> Topology:
    """Return a version with the model."""
    window = Window(10)
    window.append([(k, Event(name, "entry", float(k))) for k, name in enumerate(NAMES)])
    model = build_model(*learned, BINS, window, changes or [], False, misses=missed)
    zones = [Zone(f"{name}/1", name, 100, 100) for name in NAMES]
    cameras = [Camera(name, [f"{name}/1"]) for name in NAMES]
    return Topology(
        TOPOLOGY_SCHEMA, "hq", "01J", 1, 0.0, 600, "", cameras, zones, [], [], model=model
    )


def chances(topology: Topology, known: bool) -> dict[str, float]:
    """Return predictions from a; ``known``: zone of entry and block."""
    predictor = Predictor(topology)
    predictor.observe(Event("a", "entry", 996.0, track="1"))
    exit_ = Event("a", "exit", 1000.0, 0.92, 0.1, "1") if known else Event("a", "exit", 1000.0)
    prediction = predictor.predict(exit_)
    found = {"": prediction.leave, "a": 0.0, "b": 0.0, "c": 0.0}
    for one in prediction.next:
        found[one.camera] += one.probability
    return found


@pytest.mark.parametrize("known", [False, True])
def test_the_posterior_as_it_is(learned: tuple[Scene, Posterior], known: bool) -> None:
    version = made(learned)
    model = rows_of(version)
    assert [row.zone for row in model.onward or []] == ["a/1", "b/1", "c/1"]
    found = chances(version, known)
    assert (found["b"], found["c"], found[""]) == pytest.approx((0.6, 0.3, 0.1), abs=0.05)
    contexts = {(row.entry, row.block) for row in model.contexts or [] if row.zone == "a/1"}
    assert ("a/1", 5) in contexts
    assert model.zones[0].stay == pytest.approx([4.0] * 11)
    assert [(c.camera, round(c.share, 6), c.last_event) for c in model.cameras] == [
        ("a", 0.333333, 0.0),
        ("b", 0.333333, 1e-6),
        ("c", 0.333333, 2e-6),
    ]


@pytest.mark.parametrize("known", [False, True])
def test_a_way_that_has_closed_is_not_expected(
    learned: tuple[Scene, Posterior], known: bool
) -> None:
    """The other paths share its probability, in every context."""
    found = chances(made(learned, [ChangePoint(0, 1, 20_000.0, 0.9, 0.0, 50.0)]), known)
    assert found["b"] < 0.01
    assert found["c"] == pytest.approx(0.3 / 0.4, abs=0.07)


@pytest.mark.parametrize("known", [False, True])
def test_what_missed_detections_make_is_expected(
    learned: tuple[Scene, Posterior], known: bool
) -> None:
    """Of 800 departures at a, 80 come back past a camera that misses them, in every context.

    Nine come to c so, where the fit has found many more.
    """
    pairs = np.zeros(2, np.intp), np.array([0, 2])
    missed = MissedTransitions(
        *pairs, np.array([80.0, 9.0]), np.array([40.0, 8.0]), np.array([2.0, 2.0])
    )
    version = made(learned, missed=missed)
    found = chances(version, known)
    share = 0.1 / 1.1
    assert found["a"] == pytest.approx(share, abs=0.01)
    assert (found["b"], found["c"]) == pytest.approx((0.6 / 1.1, 0.3 / 1.1), abs=0.05)
    assert sum(found.values()) == pytest.approx(1.0)
    [back] = [one for one in (rows_of(version).onward or [])[0].next_ if one.missed]
    assert back.to == "a/1"
    mass = masses_on_bins(back.hazard, BINS)
    assert mass.sum() == pytest.approx(share, rel=0.02)
    assert abs(BINS.centres[mass.argmax()] - 40.0) < 3.0


def test_where_every_way_has_closed_no_context_has_fewer_departures_than_none(
    learned: tuple[Scene, Posterior],
) -> None:
    """Transitions are counted in single precision and may exceed the departures."""
    scene, posterior = learned
    levels = [
        level._replace(
            departures=np.ones(len(level.departures)),
            transitions=csr_array((level.transitions > 0) * np.float32(1 + 1e-6)),
        )
        for level in posterior.levels
    ]
    c = posterior.fit.candidates
    closed = [
        ChangePoint(int(u), int(v), 20_000.0, 0.9, 0.0, 50.0)
        for u, v in zip(c.source, c.target, strict=True)
    ]
    rows = rows_of(made((scene, posterior._replace(levels=levels)), closed)).contexts or []
    assert rows
    assert min(row.departures for row in rows) == 0.0


def test_without_a_posterior_only_the_zones(learned: tuple[Scene, Posterior]) -> None:
    version = made((learned[0], None))
    model = rows_of(version)
    assert (model.onward, model.entered, model.contexts) == (None, None, None)
    assert model.zones[0].departures == 800
    assert model.zones[0].arrival_rate == pytest.approx(800 / learned[0].last, rel=1e-3)
    assert [Hazards(version).outcomes(k) for k in range(3)] == [None] * 3


def test_only_so_many_outcomes_are_kept(
    learned: tuple[Scene, Posterior], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert NEXT_ZONES_MAX >= 3
    monkeypatch.setattr("camtopod.learn.prediction_model.NEXT_ZONES_MAX", 1)
    first = (rows_of(made(learned)).onward or [])[0]
    assert [outcome.to for outcome in first.next_] == ["b/1"]
