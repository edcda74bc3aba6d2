"""The log priors for a tracker's association: their sums, and the accuracy of the association."""

from __future__ import annotations

import math

import numpy as np
import pytest
from model_rows import (
    CameraModel,
    EntryKernel,
    LabelModel,
    Model,
    Onward,
    Outcome,
    ZoneModel,
    with_rows,
)
from msgspec.structs import replace
from scipy.optimize import linear_sum_assignment

from bench.support.prediction_scores import next_entries
from camtopod.client import Gate, UnknownPlace
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict import anywhere
from camtopod.predict.predictor import Predictor
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Camera,
    Event,
    Histogram,
    Link,
    Topology,
    Transit,
    Zone,
)
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.topology.lag_bins import LagBins

COV = [[0.001, 0.0], [0.0, 0.001]]
TRAIN_SHARE = 0.7
CUTOFFS_SECONDS = (5.0, 10.0, 20.0, 30.0, 60.0, 120.0)


def link(from_: str, to: str, probability: float, median: float) -> Link:
    transit = Transit(median, median, 1.0, median - 1.0, median, median + 1.0)
    return Link(from_, to, "unseen", probability, 100 * probability, transit, 0.0, 0.1)


def a_topology(*links: Link, ahead: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Topology:
    """Return cameras a (two zones), b and c (one each), with these clock offsets.

    From outside an object comes to each zone every 1,000 s.
    """
    zones = [
        Zone("a/1", "a", 100, 100, 0.1, 0.5, COV),
        Zone("a/2", "a", 100, 100, 0.9, 0.5, COV),
        Zone("b/1", "b", 100, 100, 0.5, 0.5, COV),
        Zone("c/1", "c", 100, 100),
    ]
    model = Model(
        4.0,
        0.1,
        -20.0,
        120.0,
        [ZoneModel(zone.id, 100, 0.001, []) for zone in zones],
        [CameraModel(name, 1 / 3, 0.0) for name in "abc"],
        clocks_corrected=True,
    )
    cameras = [
        Camera(name, [zone.id for zone in zones if zone.camera == name], offset)
        for name, offset in zip("abc", ahead, strict=True)
    ]
    plain = Topology(TOPOLOGY_SCHEMA, "hq", "01J", 7, 0.0, 800, "", cameras, zones, [*links], [])
    return with_rows(plain, model)


THREE = a_topology(
    link("a/1", "b/1", 0.5, 8.0), link("a/1", "c/1", 0.3, 20.0), link("a/1", "a/2", 0.1, 30.0)
)
LEFT = Event("a", "exit", 1000.0, 0.1, 0.5, "17")


def came(camera: str, t: float, x: float | None = 0.5) -> Event:
    return Event(camera, "entry", t, x, None if x is None else 0.5)


def integral(gate: Gate, from_zone: str, to_camera: str, to_zone: str | None = None) -> float:
    """Return the integral of the density over all times: it is constant in each lag bin."""
    model = gate.topology.model
    assert model is not None
    bins = LagBins(model.lag_min, model.lag_max, model.lag_scale, model.lag_step)
    lags = zip(bins.centres.tolist(), bins.widths.tolist(), strict=True)
    return sum(
        math.exp(gate.gate(from_zone, 0.0, to_camera, lag, to_zone)) * width for lag, width in lags
    )


# --- what it means --------------------------------------------------------------------------------


def test_the_density_sums_to_the_probability_of_the_link() -> None:
    gate = Gate(THREE)
    found = [integral(gate, "a/1", camera) for camera in "bca"]

    assert found == pytest.approx([0.5, 0.3, 0.1], abs=0.002)
    assert sum(found) + math.exp(gate.gate_gone("a/1")) == pytest.approx(1.0, abs=0.002)
    assert integral(gate, "a/1", "a", "a/2") == pytest.approx(0.1, abs=0.002)
    assert integral(gate, "a/1", "a", "a/1") == 0.0
    assert gate.gate_gone("b/1") == 0.0, "nobody was ever seen again"


def test_clocks_that_are_ahead_are_taken_into_account() -> None:
    right, wrong = Gate(THREE), Gate(a_topology(*THREE.links, ahead=(30.0, 100.0, 0.0)))
    assert wrong.gate("a/1", 1030.0, "b", 1108.0) == right.gate("a/1", 1000.0, "b", 1008.0)
    odds = wrong.affinity([replace(LEFT, t=1030.0)], [came("b", 1108.0)])
    assert odds == pytest.approx(right.affinity([LEFT], [came("b", 1008.0)]))


def test_odds_are_those_of_one_object_against_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """By links: who may appear anywhere counts as gone, and as from outside."""
    exits, entries = [LEFT], [came("b", 1009.0), came("c", 1021.0, None)]
    by_links = Gate(THREE).affinity(exits, entries, now=1e9)
    monkeypatch.setattr(anywhere, "surplus", lambda departures, leave, cameras: 0.0)
    gate = Gate(THREE)
    assert by_links == pytest.approx(gate.affinity(exits, entries, now=1e9))

    exits = [LEFT, replace(LEFT, t=1004.0, x=0.9)]
    entries = [came("b", 1009.0), came("c", 1021.0, None), came("a", 1030.0, 0.9)]
    odds = gate.affinity(exits, entries)

    assert odds.shape == (2, 3)
    gone = gate.gate_gone("a/1", 30.0)
    for column, (entry, zone) in enumerate(zip(entries, ("b/1", "c/1", "a/2"), strict=True)):
        same = gate.gate("a/1", LEFT.t, entry.camera, entry.t, zone)
        assert odds[0, column] == pytest.approx(same - gate.gate_new(entry.camera, zone) - gone)
    assert (odds[1] == -math.inf).all(), "from a/2 no way is known"
    assert gate.affinity(exits, entries, now=1e9)[0] == pytest.approx(
        odds[0] + gone - gate.gate_gone("a/1")
    )


def overlapping() -> Topology:
    """Objects that enter at a/2 appear at b/1 four seconds later, whenever they leave at a/1."""
    bins = LagBins(-20.0, 120.0)
    four = Histogram(bins.bin_of(4.0) + bins.first, [1.0])
    onward = [
        Onward("a/1", 0.5, [Outcome("b/1", 0.5, Histogram(bins.bin_of(-9.0) + bins.first, [1e-3]))])
    ]
    return with_rows(THREE, onward=onward, entered=[EntryKernel("a/2", "b/1", four)])


def test_an_open_track_that_came_when_those_from_there_do_is_the_same_object() -> None:
    """The passage lasts ten seconds, so only the entry six seconds before the exit matches."""
    exits = [LEFT]
    own = Event("a", "entry", 990.0, 0.9, 0.5, "17")
    others = [came("b", 994.0), came("b", 998.0)]
    gate = Gate(overlapping())
    known = gate.affinity(exits, [own, *others])[0]

    assert known[1] > 2.0
    assert known[1] > known[2] + 3.0
    unknown = gate.affinity(exits, others)[0]
    assert known[1] > unknown[0] + 2.0
    elsewhere = replace(own, camera="b"), replace(own, track="18"), replace(own, t=1000.5)
    for entry in elsewhere:
        assert gate.affinity(exits, [entry, *others])[0, 1:] == pytest.approx(unknown, abs=0.05)


def test_what_is_not_there_or_makes_no_sense_is_said() -> None:
    gate = Gate(THREE)
    there = r"^version 7 has no zone 'a/3'; there are a/2, a/1, c/1, b/1$"
    with pytest.raises(UnknownPlace, match=there):
        gate.gate("a/3", 0.0, "b", 8.0)
    with pytest.raises(KeyError, match="no zone of b called 'a/1'; there are b/1"):
        gate.gate_new("b", "a/1")
    with pytest.raises(ValueError, match=r"an entry of b at 3\.0 among what should be exit events"):
        gate.affinity([came("b", 3.0)], [])
    with pytest.raises(ValueError, match="finite numbers of seconds"):
        gate.gate("a/1", math.nan, "b", 8.0)


def test_of_a_camera_without_a_zone_nothing_is_said_and_an_unknown_one_is_refused() -> None:
    gate = Gate(replace(THREE, model=None, cameras=[*THREE.cameras, Camera("new", [])]))
    odds = gate.affinity(
        [LEFT, replace(LEFT, camera="new")], [came("b", 1008.0), came("new", 1008.0)]
    )

    assert odds[0, 0] > 0
    assert (odds[:, 1] == 0).all()
    assert (odds[1] == 0).all()
    assert Gate(THREE).affinity([], [came("b", 1.0)]).shape == (0, 1)
    assert Gate(THREE).affinity([LEFT], []).shape == (1, 0)
    for exits, entries in (([replace(LEFT, camera="new")], []), ([], [came("new", 1008.0)])):
        with pytest.raises(UnknownPlace, match="no camera 'new'; there are"):
            Gate(THREE).affinity(exits, entries)
    with pytest.raises(UnknownPlace, match="no zone 'new/1'; there are"):
        Gate(THREE).gate_gone("new/1")


# --- how right it is ------------------------------------------------------------------------------


class Site:
    """A simulated site of 12 cameras, learned from 70 % of 48 minutes; the rest is associated."""

    def __init__(self, seed: int) -> None:
        settings = SimSettings(
            cameras=12, hours=0.8, seed=seed, objects_per_second=0.12, overlap_share=0.0
        )
        events, truth = simulate(settings)
        cut = int(TRAIN_SHARE * len(events))
        learner = Learner(Settings(refit_share=1e9, refit_hours=1e9))
        for event in events[:cut]:
            learner.receive(event)
        learner.flush()
        assert learner.topology is not None
        self.topology = learner.topology

        # The events to associate, and the truth about them.
        exits = [k for k in range(cut, len(events)) if events[k].kind == "exit"]
        entries = [k for k in range(cut, len(events)) if events[k].kind == "entry"]
        next_entry = next_entries(events, truth)
        column = {k: number for number, k in enumerate(entries)}
        self.exits = [events[k] for k in exits]
        self.entries = [events[k] for k in entries]
        self.truth = np.array([column.get(next_entry[k], -1) for k in exits])
        """(exits,) which entry is the same object's next, -1: none."""
        self.lag = np.array([[entry.t - left.t for entry in self.entries] for left in self.exits])

    def share_right(self, value: np.ndarray) -> float:
        """Return the share of exits for which the best matching of values above 0 is correct."""
        rows, columns = linear_sum_assignment(np.maximum(value, 0.0), maximize=True)
        matched = np.full(len(self.truth), -1)
        some = value[rows, columns] > 0
        matched[rows[some]] = columns[some]
        return float(np.mean(matched == self.truth))


@pytest.fixture(scope="module")
def site() -> Site:
    return Site(3)


def test_association_beats_the_nearest_in_time(site: Site) -> None:
    """It beats two simple methods, each with its best cutoff, in the mean over two sites.

    It is right for at least a quarter of the exits more than the nearest in time at a linked
    camera, and not worse than the nearest to the learned median of the link. On one site, the
    latter is decided by an exit or two.
    """
    shares = np.mean([shares_right(site), shares_right(Site(4))], axis=0)
    association, nearest, by_median = shares.tolist()
    assert association >= nearest + 0.25, shares
    assert association >= by_median, shares


def shares_right(site: Site) -> tuple[float, float, float]:
    """Return the share of exits that are right by association and by the two simple methods."""
    association = site.share_right(Gate(site.topology).affinity(site.exits, site.entries))

    pairs = {frozenset(pair.cameras) for pair in site.topology.pairs}
    linked = np.array(
        [[frozenset((a.camera, b.camera)) in pairs for b in site.entries] for a in site.exits]
    )
    forward = np.where(linked & (site.lag > 0), site.lag, np.inf)
    nearest = max(site.share_right(cutoff - forward) for cutoff in CUTOFFS_SECONDS)

    predictor = Predictor(site.topology)
    zones = site.topology.zones
    links = [one for one in site.topology.links if one.relation != "visible"]
    median = {(one.from_, one.to): one.transit.q50 for one in links}
    left = [zones[predictor.zone_of(event)].id for event in site.exits]
    came_to = [zones[predictor.zone_of(event)].id for event in site.entries]
    usual = np.array([[median.get((a, b), np.inf) for b in came_to] for a in left])
    off = np.abs(site.lag - usual)
    by_median = max(site.share_right(cutoff - off) for cutoff in CUTOFFS_SECONDS)
    return association, nearest, by_median


def test_labels_that_differ_speak_against_one_object() -> None:
    """By the rule of the version; an exit without one has its entry's."""
    shares = {zone.id: [0.1, 0.9] for zone in THREE.zones}
    labels = LabelModel(["bus", "car"], 0.9, shares)
    gate = Gate(with_rows(THREE, labels=labels))
    began = replace(LEFT, kind="entry", t=990.0, label="bus")
    entries = [began, *(replace(came("b", 1008.0), label=label) for label in ("bus", "car", None))]

    odds = gate.affinity([LEFT, replace(LEFT, label="car")], entries)[:, 1:]

    assert odds[0, :2] - odds[0, 2] == pytest.approx(np.log([0.9 / 0.1 + 0.1, 0.1]))
    assert odds[1, :2] - odds[1, 2] == pytest.approx(np.log([0.1, 0.9 / 0.9 + 0.1]))
