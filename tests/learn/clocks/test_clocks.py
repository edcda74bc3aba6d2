"""Clock offsets: correlograms, paths walked in both directions, and networks of offsets."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from camtopod.learn.clocks import correlogram, offsets
from camtopod.learn.clocks.correlogram import (
    LAGS,
    Correlograms,
    null_expectation,
    significant_peaks,
)
from camtopod.learn.clocks.offsets import (
    REFRESH_SHARE,
    Clocks,
    ClockState,
    Difference,
    estimate_clocks,
    right_clocks,
    solve_offsets,
)
from camtopod.learn.clocks.two_way_paths import find_two_way_paths
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.learn.traffic.labelled_events import Scene, ZoneRef
from camtopod.predict.predictor import Predictor
from camtopod.records import Event, Topology

HOURS_2 = 7200.0
ENTRY, EXIT = True, False


# --- counting lags ---


def some_events(seed: int, n: int, labels: int, span: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return np.sort(rng.uniform(0.0, span, n)), rng.integers(0, labels, n).astype(np.int32)


@pytest.mark.parametrize("bin_seconds", [1.0, 4.0])
def test_lags_are_counted_one_by_one(bin_seconds: float) -> None:
    left, came = some_events(5, 60, 2, 3000.0), some_events(6, 50, 2, 3000.0)
    found = Correlograms(left, came, 2, bin_seconds).between(np.array([0, 1]), np.array([1, 1]))
    first = min(left[0][0], came[0][0])
    slow = np.zeros((2, 2 * LAGS + 1))
    for t, zone in zip(*left, strict=True):
        for s, other in zip(*came, strict=True):
            lag = int((s - first) / bin_seconds) - int((t - first) / bin_seconds)
            if other == 1 and abs(lag) <= LAGS:
                slow[zone, lag + LAGS] += 1
    assert (found == slow).all()


def test_beyond_the_limit_the_newest_time_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    t = np.arange(0.0, 20 * LAGS, 50.0)
    zone = np.zeros(len(t), np.int32)
    monkeypatch.setattr(correlogram, "SPECTRA_MAX", 2)
    found = Correlograms((t, zone), (t, zone), 1, 1.0).between(zone[:1], zone[:1])
    assert found[0, LAGS] == np.sum(t >= t[-1] - 4 * LAGS)


def test_what_stands_out_is_the_peak_and_not_the_rhythm() -> None:
    lag = np.arange(-LAGS, LAGS + 1)
    rate = 20.0 + 10.0 * np.cos(lag / 900.0)
    counts = np.random.default_rng(1).poisson(rate + 12.0 * np.exp(-0.5 * ((lag - 30) / 4) ** 2))[
        None, :
    ]
    clear = significant_peaks(
        counts.astype(np.float32), null_expectation(counts.astype(np.float32))
    )[0]
    assert abs(int(np.argmax(clear)) - LAGS - 30) < 4
    assert np.mean(clear[np.abs(lag - 30) > 20] > 0) < 0.05


def test_of_a_large_network_the_promising_pairs_of_cameras_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    walks = ring([0.0, 0.0, -25.0, 0.0, 0.0, 0.0, 8.0, 0.0])
    everything = walks.clocks()
    monkeypatch.setattr(
        offsets, "ZONE_PAIRS_MAX", 8 * 8 + 7
    )  # of 28 pairs of cameras, a good quarter
    assert walks.clocks().offset == pytest.approx(everything.offset, abs=0.1)


# --- ways walked in both directions ---


def lag_counts(seed: int, *peaks: tuple[float, float, int]) -> np.ndarray:
    """Return a correlogram (1, lags): a null rate of 1 a bin, and peaks (at, spread, number)."""
    rng = np.random.default_rng(seed)
    counts = rng.poisson(1.0, 2 * LAGS + 1)
    for at, spread, number in peaks:
        lags = np.rint(rng.normal(at, spread, number)).astype(int)
        counts += np.bincount(lags + LAGS, minlength=2 * LAGS + 1)
    return counts[None, :].astype(np.float32)


@pytest.mark.parametrize(
    ("transit", "ahead"), [(20.0, 0.0), (20.0, 28.0), (-3.0, -12.5), (60.0, 400.0)]
)
def test_twice_the_difference_is_between_there_and_back(transit: float, ahead: float) -> None:
    errors = []
    for seed in range(8):
        forth = lag_counts(seed, (transit + ahead, 3.0, 300))
        back = lag_counts(100 + seed, (transit - ahead, 3.0, 200))
        (way,) = find_two_way_paths(forth, back)
        assert way.transit == pytest.approx(transit, abs=2.0)
        assert way.spread == pytest.approx(3.0, rel=0.4)
        errors.append((way.ahead - ahead) / way.sd)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


# --- a network ---


class Walks:
    """Walks between the doors of cameras, by the cameras' clocks."""

    def __init__(self, ahead: list[float], seed: int = 0) -> None:
        self.ahead, self.rng = np.array(ahead), np.random.default_rng(seed)
        self.doors: list[tuple[int, int]] = []
        self.events: list[tuple[float, int, bool]] = []

    def door(self, camera: int, number: int) -> int:
        """Return the index of a camera's door."""
        if (camera, number) not in self.doors:
            self.doors.append((camera, number))
        return self.doors.index((camera, number))

    def way(
        self,
        a: tuple[int, int],
        b: tuple[int, int],
        seconds: float,
        walks: int = 150,
        spread: float = 0.25,
    ) -> None:
        """Add people who leave at door ``a`` and enter at ``b``."""
        start = self.rng.uniform(0.0, HOURS_2, walks)
        u, v = self.door(*a), self.door(*b)
        later = seconds * np.exp(spread * self.rng.standard_normal(walks))
        self.events += [(t + self.ahead[a[0]], u, EXIT) for t in start]
        self.events += [(t + self.ahead[b[0]], v, ENTRY) for t in start + later]

    def both(
        self, a: tuple[int, int], b: tuple[int, int], seconds: float, back: float | None = None
    ) -> None:
        self.way(a, b, seconds)
        self.way(b, a, back or seconds)

    def scene(self) -> Scene:
        rows = sorted(self.events)
        t, door = np.array([row[0] for row in rows]), np.array([row[1] for row in rows], np.int32)
        camera = np.array([self.doors[k][0] for k in door], np.int32)
        left = np.array([row[2] is EXIT for row in rows])
        nan, none = np.full(len(t), np.nan), np.full(len(t), -1, np.int32)
        departures = Departures(
            t[left], door[left], camera[left], nan[left], nan[left], none[left], none[left]
        )
        arrivals = Arrivals(t[~left], door[~left], camera[~left], nan[~left], nan[~left])
        zones = [ZoneRef(camera, number, None) for camera, number in self.doors]
        counts = np.zeros(len(zones), np.int64)
        cameras = len(self.ahead)
        return Scene(
            zones,
            departures,
            arrivals,
            counts,
            counts,
            np.zeros(cameras, bool),
            t[0],
            t[-1],
        )

    def clocks(self) -> Clocks:
        cameras = len(self.ahead)
        return estimate_clocks(self.scene(), cameras, right_clocks(cameras))


def ring(ahead: list[float], seed: int = 0) -> Walks:
    """Return cameras in a ring, each with a door to the next and one to the previous."""
    walks = Walks(ahead, seed)
    n = len(ahead)
    for camera in range(n):
        walks.both((camera, 1), ((camera + 1) % n, 2), 8.0 + 3.0 * camera)
    return walks


def test_wrong_clocks_are_found_and_right_ones_stay() -> None:
    ahead = [0.0, 0.0, -25.0, 0.0, 7.0, 0.0]
    found = ring(ahead).clocks()
    assert found.is_identified.all()
    assert found.offset == pytest.approx(ahead, abs=0.6)
    assert (found.offset[[0, 1, 3, 5]] == 0).all()
    assert (found.sd < 0.5).all()


def test_where_all_go_one_way_nothing_is_known() -> None:
    walks = Walks([0.0, 20.0, 0.0, 0.0])
    for camera in range(4):
        walks.way((camera, 1), ((camera + 1) % 4, 2), 12.0, walks=300)
    found = walks.clocks()
    assert not found.is_identified.any()
    assert (found.offset == 0).all()
    assert np.isinf(found.sd).all()


def test_one_door_for_all_on_a_one_way_road_is_no_way_back() -> None:
    """Objects that leave the second camera entered the first earlier; that is no path back."""
    walks = Walks([0.0, 0.0, 0.0])
    start = walks.rng.uniform(0.0, HOURS_2, 300)
    for camera in range(3):
        door = walks.door(camera, 1)
        came = start + 14.0 * camera * np.exp(0.05 * walks.rng.standard_normal(300))
        walks.events += [(t, door, ENTRY) for t in came] + [(t + 4.0, door, EXIT) for t in came]
    assert (walks.clocks().offset == 0).all()


def two_cameras(ahead: float = 0.0) -> Walks:
    """Return two cameras, each with a second door through which others come and go."""
    walks = Walks([0.0, ahead])
    for camera in range(2):
        walks.way((camera, 2), (camera, 2), 600.0, walks=50)
    return walks


def test_stays_in_overlapping_views_tell_nothing_about_clocks() -> None:
    """People are in both views for 35 s on one way and for 12 s on the other."""
    walks = two_cameras()
    walks.way((0, 1), (1, 1), -35.0, spread=0.1)
    walks.way((1, 1), (0, 1), -12.0, spread=0.1)
    assert (walks.clocks().offset == 0).all()


def test_one_path_that_takes_longer_back_is_no_wrong_clock() -> None:
    walks = two_cameras()
    walks.both((0, 1), (1, 1), 17.0, back=8.0)
    assert (walks.clocks().offset == 0).all()


@pytest.mark.parametrize("ahead", [4.0, -30.0])
def test_borders_crossed_at_once_show_a_wrong_clock(ahead: float) -> None:
    walks = two_cameras(ahead)
    walks.both((0, 1), (1, 1), -1.0)
    found = walks.clocks().offset
    assert found[1] - found[0] == pytest.approx(ahead, abs=0.2)


# --- bringing differences together ---


def differences_of(
    ahead: list[float], pairs: list[tuple[int, int]], seed: int = 0
) -> list[Difference]:
    rng = np.random.default_rng(seed)
    return [
        Difference(a, b, ahead[b] - ahead[a] + 0.1 * rng.standard_normal(), 0.1, 10.0)
        for a, b in pairs
    ]


ALL_PAIRS = [(a, b) for a in range(5) for b in range(a)]


def test_an_outlier_changes_nothing() -> None:
    ahead = [0.0, 0.0, 12.0, 0.0, -3.0]
    found = differences_of(ahead, ALL_PAIRS)
    wild = [*found[1:], found[0]._replace(ahead=55.0)]
    for differences in (found, wild):
        assert solve_offsets(differences, np.ones(5, int), right_clocks(5)).offset == pytest.approx(
            ahead, abs=0.3
        )


def test_cameras_without_a_difference_take_hardly_any_memory() -> None:
    cameras = 2_000
    differences = differences_of([0.0, 0.0, 12.0, 0.0, -3.0], ALL_PAIRS)
    few = solve_offsets(differences, np.ones(5, int), right_clocks(5))
    tracemalloc.start()
    try:
        many = solve_offsets(differences, np.ones(cameras, int), right_clocks(cameras))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert many.offset[:5] == pytest.approx(few.offset, abs=0.01)
    assert not many.offset[5:].any()
    assert peak < cameras**2, "a table of all pairs of cameras has eight bytes for each"


def test_of_two_clocks_the_busier_is_right_unless_it_was_wrong_before() -> None:
    (difference,) = differences_of([0.0, 20.0], [(0, 1)])
    for weight, wrong in ((np.array([9, 1]), 1), (np.array([1, 9]), 0)):
        assert np.flatnonzero(
            solve_offsets([difference], weight, right_clocks(2)).offset
        ).tolist() == [wrong]
    known = Clocks(np.array([0.0, 20.0]), np.full(2, 0.2), np.ones(2, bool))
    assert np.flatnonzero(solve_offsets([difference], np.array([2, 3]), known).offset).tolist() == [
        1
    ]


def test_the_clocks_are_estimated_again_when_there_is_enough_new() -> None:
    scene = ring([0.0, 0.0, -25.0, 0.0]).scene()
    events = len(scene.departures.t) + len(scene.arrivals.t)
    state = ClockState()
    state.update(scene, 4, events)
    assert np.flatnonzero(state.clocks.offset).tolist() == [2]
    state.update(scene, 4, events + int(0.9 * REFRESH_SHARE * events))
    assert state.learned == events
    state.update(scene, 4, events + int(1.1 * REFRESH_SHARE * events))
    assert state.learned > events
    assert np.flatnonzero(state.clocks.offset).tolist() == [2]
    state.update(scene, 5, events)  # a new camera
    assert len(state.clocks.offset) == 5


# --- the learner ---


def learned(correct_clocks: bool) -> Topology:
    """Learn four cameras in a ring, the clock of the third 14 s ahead.

    Doors are left and right in the image.
    """
    walks = ring([0.0, 0.0, 14.0, 0.0])
    learner = Learner(Settings(correct_clocks=correct_clocks, refit_hours=24.0, refit_share=10.0))
    noise = np.random.default_rng(1)
    for t, door, entry in sorted(walks.events):
        camera, number = walks.doors[door]
        x, y = np.clip(noise.normal((0.2 if number == 1 else 0.8, 0.5), 0.02), 0, 1).round(4)
        learner.receive(
            Event(f"c{camera}", "entry" if entry else "exit", round(1e6 + t, 6), float(x), float(y))
        )
    learner.flush()
    assert learner.topology is not None
    return learner.topology


@pytest.fixture(scope="module")
def stated() -> Topology:
    """Return the events by the cameras' own clocks."""
    return learned(False)


@pytest.fixture(scope="module")
def corrected() -> Topology:
    """Return the events in corrected time."""
    return learned(True)


def medians(topology: Topology) -> dict[str, float]:
    """Return the median transit time of each link by its cameras."""
    camera = {zone.id: zone.camera for zone in topology.zones}
    return {
        camera[k.from_] + camera[k.to]: k.transit.q50
        for k in topology.links
        if camera[k.from_] != camera[k.to]
    }


def test_offsets_are_published(stated: Topology, corrected: Topology) -> None:
    for topology in (stated, corrected):
        offsets = {camera.id: camera.clock_offset for camera in topology.cameras}
        assert offsets == pytest.approx({"c0": 0.0, "c1": 0.0, "c2": 14.0, "c3": 0.0}, abs=0.5)
        assert all(0 < (camera.clock_offset_sd or 0.0) < 0.5 for camera in topology.cameras)


def test_transit_times_are_in_right_time_when_asked(stated: Topology, corrected: Topology) -> None:
    truth = {"c0c1": 8.0, "c1c2": 11.0, "c2c3": 14.0, "c3c0": 17.0}
    truth |= {name[2:] + name[:2]: seconds for name, seconds in truth.items()}
    assert medians(corrected) == pytest.approx(truth, rel=0.1)
    (ahead,) = (camera.clock_offset for camera in stated.cameras if camera.id == "c2")
    shifted = {
        name: t + ahead * ((name[2:] == "c2") - (name[:2] == "c2"))
        for name, t in medians(corrected).items()
    }
    assert medians(stated) == pytest.approx(shifted, abs=0.01)
    assert [pair.relation for pair in stated.pairs] == ["unseen_path"] * 4


def test_predictions_are_stated_by_the_clocks_that_will_tell(
    stated: Topology, corrected: Topology
) -> None:
    """An exit at c1 arrives at c2 in 11 s, when the clock there shows 25 s more."""
    for topology, seconds in ((stated, 25.0), (corrected, 11.0)):
        prediction = Predictor(topology).predict(Event("c1", "exit", 1e6 + 9000.0, 0.2, 0.5))
        first = prediction.next[0]
        assert (first.camera, prediction.t) == ("c2", 1e6 + 9000.0)
        assert first.q50 == pytest.approx(seconds, abs=1.5)


def test_what_has_been_seen_by_a_wrong_clock_counts(stated: Topology) -> None:
    """From c2, 14 s ahead, to c3 takes 14 s; by the clocks, the entry at c3 precedes the exit."""
    leaves = Event("c2", "exit", 1e6 + 9000.0, 0.2, 0.5)
    alone, seen = Predictor(stated), Predictor(stated)
    seen.observe(Event("c3", "entry", leaves.t - 0.5, 0.8, 0.5))
    for predictor, q50 in ((seen, -0.5), (alone, None)):
        first = predictor.predict(leaves).next[0]
        assert first.camera == "c3"
        if q50 is None:
            assert first.q50 > 0
        else:
            assert first.q50 == pytest.approx(q50, abs=1.0)
