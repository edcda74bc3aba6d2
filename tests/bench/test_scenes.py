"""Simulated scenes: their ground truth is what the people in them do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from bench.scenes.crowd import CrowdSettings, simulate_crowd
from bench.scenes.floor_plan import Piece, Walks, make_pieces, sampled, sightings, walk
from bench.scenes.hall import HallSettings, simulate_hall
from bench.scenes.recording import Faults, Sightings, broken, clipped, recorded
from bench.scenes.road import GREEN_SHARE, RoadSettings, _green, simulate_road
from bench.scenes.walkway import WalkwaySettings, simulate_walkway
from camtopod.codec import event_from_json, to_json
from camtopod.records import Event
from camtopod.sim.scoring import next_entries
from camtopod.sim.truth import CLUTTER, Truth

Recording = tuple[list[Event], Truth]
SCENES: dict[str, Callable[[int], Recording]] = {
    "hall": lambda seed: simulate_hall(HallSettings(seed=seed, seconds=900.0)),
    "crowd": lambda seed: simulate_crowd(CrowdSettings(seed=seed, seconds=300.0)),
    "walkway": lambda seed: simulate_walkway(WalkwaySettings(seed=seed)),
    "road": lambda seed: simulate_road(RoadSettings(seed=seed, seconds=1800.0, per_second=0.4)),
}
SIMULATE: dict[str, tuple[Callable[..., Recording], msgspec.Struct]] = {
    "hall": (simulate_hall, HallSettings(seconds=400.0)),
    "crowd": (simulate_crowd, CrowdSettings(seconds=120.0)),
    "walkway": (simulate_walkway, WalkwaySettings()),
    "road": (simulate_road, RoadSettings(seconds=1200.0, per_second=0.4)),
}
NO_FAULTS = Faults(missed=0.0, clutter=0.0, broken_every=np.inf, short=0.0, noise=0.0)


@cache
def made(scene: str, seed: int = 0) -> Recording:
    return SCENES[scene](seed)


@dataclass(frozen=True)
class Stay:
    """A recorded passage."""

    camera: str
    number: int
    t_in: float
    t_out: float


def stays(events: list[Event], truth: Truth) -> dict[int, list[Stay]]:
    """Return recorded passages by person, in order of their number."""
    halves: dict[tuple[int, int], dict[str, Event]] = {}
    for event, who, number in zip(events, truth.identity, truth.passage, strict=True):
        if who != CLUTTER:
            assert event.kind not in halves.setdefault((who, number), {}), (
                "one entry and one exit a passage"
            )
            halves[who, number][event.kind] = event
    result: dict[int, list[Stay]] = {}
    for (who, number), half in sorted(halves.items()):
        begin, end = half["entry"], half["exit"]
        assert (begin.camera, begin.track) == (end.camera, end.track)
        result.setdefault(who, []).append(Stay(begin.camera, number, begin.t, end.t))
    return result


@pytest.mark.parametrize("scene", SCENES)
def test_a_recording_is_consistent(scene: str) -> None:
    events, truth = made(scene)
    assert len(events) == len(truth.identity) == len(truth.passage) == len(truth.zone)
    assert [e.t for e in events] == sorted(e.t for e in events)
    assert {e.camera for e in events} <= set(truth.cameras)
    assert all(event_from_json(to_json(e)) == e for e in events[:200])
    assert all((e.x is None) == (scene == "road") for e in events)
    assert all(e.track is not None for e in events)
    for passages in stays(events, truth).values():
        assert [p.t_in for p in passages] == sorted(p.t_in for p in passages), (
            "numbered in order of entry"
        )
        assert all(p.t_in <= p.t_out for p in passages)
    for event, who, zone in zip(events, truth.identity, truth.zone, strict=True):
        assert zone < 0 or (who >= 0 and truth.zones[zone].camera == event.camera)


@pytest.mark.parametrize("scene", SCENES)
def test_same_seed_same_recording_and_another_another(scene: str) -> None:
    assert SCENES[scene](0) == made(scene)
    assert SCENES[scene](1)[0] != made(scene)[0]


@pytest.mark.parametrize("scene", SCENES)
def test_pairs_are_what_people_do(scene: str) -> None:
    """Overlaps equal a naive count of people in two views at once, without recording faults."""
    simulate, chosen = SIMULATE[scene]
    changes = {"faults": NO_FAULTS} | ({"gaps": False} if scene == "walkway" else {})
    events, truth = simulate(msgspec.structs.replace(chosen, **changes))
    together: Counter[tuple[str, ...]] = Counter()
    after: Counter[tuple[str, ...]] = Counter()
    for passages in stays(events, truth).values():
        for k, one in enumerate(passages):
            for other in passages[k + 1 :]:
                if one.camera != other.camera and other.t_in < one.t_out:
                    together[tuple(sorted((one.camera, other.camera)))] += 1
        for one, other in pairwise(passages):
            if one.camera != other.camera:
                after[tuple(sorted((one.camera, other.camera)))] += 1
    overlapped = {pair for pair, n in together.items() if n >= 3}
    paths = {pair for pair, n in after.items() if n >= 3} - overlapped
    assert {p.cameras for p in truth.pairs if p.relation == "overlapped"} == overlapped
    assert {p.cameras for p in truth.pairs if p.relation == "unseen_path"} == paths
    assert bool(overlapped) == (scene in ("hall", "crowd"))
    assert len(overlapped | paths) >= 5


@pytest.mark.parametrize("scene", ["walkway", "road"])
def test_links_are_as_walked(scene: str) -> None:
    events, truth = made(scene)
    lags: dict[tuple[str, str], list[float]] = {}
    for i, j in enumerate(next_entries(events, truth)):
        if (
            j >= 0
            and truth.passage[j] == truth.passage[i] + 1
            and min(truth.zone[i], truth.zone[j]) >= 0
        ):
            key = truth.zones[truth.zone[i]].id, truth.zones[truth.zone[j]].id
            lags.setdefault(key, []).append(events[j].t - events[i].t)
    links = {(link.from_, link.to): link for link in truth.links}
    assert lags.keys() <= links.keys()
    assert {key: len(seconds) for key, seconds in lags.items()} == {
        key: link.transitions for key, link in links.items() if link.transitions
    }
    for key, seconds in lags.items():
        if len(seconds) >= 50:
            assert np.median(seconds) == pytest.approx(links[key].transit.q50, rel=0.15)
    for zone in truth.zones:
        assert sum(link.probability for link in truth.links if link.from_ == zone.id) <= 1 + 1e-5


@pytest.mark.parametrize("scene", SCENES)
def test_faults_have_the_shares_asked_for(scene: str) -> None:
    simulate, chosen = SIMULATE[scene]
    size = 1.0 if scene == "crowd" else 4.0
    name = "walkers_per_hour" if scene == "walkway" else "seconds"
    chosen = msgspec.structs.replace(chosen, **{name: size * getattr(chosen, name)})
    faults = msgspec.structs.replace(NO_FAULTS, short=1.0)
    whole, truth = simulate(msgspec.structs.replace(chosen, faults=faults))
    assert min(truth.identity) >= 0
    durations = [p.t_out - p.t_in for passages in stays(whole, truth).values() for p in passages]
    assert min(durations) >= 1.0 - 1e-6
    faults = msgspec.structs.replace(faults, missed=0.3, clutter=0.2)
    events, truth = simulate(msgspec.structs.replace(chosen, faults=faults))
    clutter = sum(who == CLUTTER for who in truth.identity)
    assert clutter / len(events) == pytest.approx(0.2, abs=0.01)
    assert (len(events) - clutter) / len(whole) == pytest.approx(0.7, abs=0.06)


def test_trackers_lose_people_in_view() -> None:
    chosen = CrowdSettings(seconds=300.0, faults=NO_FAULTS)
    whole, _ = simulate_crowd(chosen)
    faults = msgspec.structs.replace(NO_FAULTS, broken_every=30.0)
    events, truth = simulate_crowd(msgspec.structs.replace(chosen, faults=faults))
    assert len(events) > 1.2 * len(whole)
    gaps = [
        after.t_in - before.t_out
        for passages in stays(events, truth).values()
        for before in passages
        for after in passages
        if after.camera == before.camera and 0 < after.t_in - before.t_out <= 3.5
    ]
    assert len(gaps) > 0.05 * len(events)
    assert min(gaps) >= 0.5


def test_people_in_a_hall_are_in_several_views_and_cross_borders_anywhere() -> None:
    events, truth = made("hall")
    several = total = 0
    for passages in stays(events, truth).values():
        total += 1
        several += any(a.t_out > b.t_in and a.camera != b.camera for a, b in pairwise(passages))
    assert several > 0.4 * total
    for camera in truth.cameras:
        x = [e.x for e in events if e.camera == camera and e.x is not None]
        assert np.quantile(x, 0.9) - np.quantile(x, 0.1) > 0.4


def test_trains_bring_platoons() -> None:
    def unevenness(share: float) -> float:
        events, _ = simulate_hall(
            HallSettings(train_share=share, walkers_per_hour=1500.0, faults=NO_FAULTS)
        )
        counts = np.histogram(
            [e.t for e in events if e.kind == "entry"], np.arange(0, 2401, 30) + 1_700_000_000
        )[0]
        return float(counts.var() / counts.mean())

    assert unevenness(0.8) > 2 * unevenness(0.0)


def test_a_crowd_is_as_large_as_asked_for_and_stays() -> None:
    events, truth = simulate_crowd(CrowdSettings(people=30, seconds=600.0, faults=NO_FAULTS))
    long = [p.t_out - p.t_in for passages in stays(events, truth).values() for p in passages]
    assert np.quantile(long, 0.9) > 40
    everybody = stays(events, truth).values()
    at_once = [
        sum(any(p.t_in <= t <= p.t_out for p in mine) for mine in everybody)
        for t in np.arange(100, 600, 20) + 1_700_000_000.0
    ]
    assert 18 < np.mean(at_once) < 36


def test_cameras_on_the_walkways_are_silent_at_times() -> None:
    chosen = WalkwaySettings(walkers_per_hour=2000.0)
    events, truth = simulate_walkway(chosen)
    always, _ = simulate_walkway(msgspec.structs.replace(chosen, gaps=False))

    def silent(recording: list[Event], camera: str) -> float:
        times = [
            0.0,
            *(e.t - chosen.start for e in recording if e.camera == camera),
            chosen.seconds,
        ]
        return float(np.diff(times).max())

    assert max(silent(always, camera) for camera in truth.cameras) < 200
    assert sum(silent(events, camera) > 300 for camera in truth.cameras) >= 3


def test_broad_ways_take_9_to_over_60_seconds() -> None:
    _, truth = simulate_walkway(
        WalkwaySettings(seed=1, walkers_per_hour=4000.0, gaps=False, faults=NO_FAULTS)
    )
    spread = [link.transit.q90 / link.transit.q10 for link in truth.links]
    assert max(spread) > 4
    assert min(spread) < 2


def test_on_the_road_the_previous_camera_tells_the_direction() -> None:
    events, truth = simulate_road(RoadSettings(seed=2, faults=NO_FAULTS))
    one: dict[str, Counter[str]] = {}
    two: dict[tuple[str, str], Counter[str]] = {}
    for passages in stays(events, truth).values():
        cameras = [p.camera for p in passages]
        for before, here, next_ in zip(cameras, cameras[1:], cameras[2:], strict=False):
            one.setdefault(here, Counter())[next_] += 1
            two.setdefault((before, here), Counter())[next_] += 1
            assert before != here

    def best(counts: dict[str, Counter[str]] | dict[tuple[str, str], Counter[str]]) -> float:
        return sum(max(c.values()) for c in counts.values()) / sum(
            c.total() for c in counts.values()
        )

    assert best(one) < 0.65
    assert best(two) > best(one) + 0.2


def test_lights_let_one_street_through_at_a_time() -> None:
    light, south, east = (80.0, 13.0), ((0, 0), (0, 1)), ((0, 0), (1, 0))
    for t in np.arange(0.0, 200.0, 0.7):
        a, b = _green(light, south, t), _green(light, east, t)
        assert (a == t) != (b == t)
        assert t <= max(a, b) <= t + (1 - GREEN_SHARE) * light[0] + 1e-9


def piece(rng: np.random.Generator) -> tuple[Piece, tuple[float, float]]:
    size = (30.0, 20.0)
    return make_pieces(size, ["a"], (0.15, 0.5), (0.0, 1.0), rng)[0], size


def test_a_piece_is_convex_and_its_picture_keeps_places_apart() -> None:
    rng = np.random.default_rng(4)
    view, size = piece(rng)
    floor = rng.uniform((0, 0), size, (4000, 2))
    at, inside = view.look(floor)
    assert ((at[inside] >= 0) & (at[inside] <= 1)).all()
    seen = floor[inside]
    middle = (seen[:-1] + seen[1:]) / 2
    assert view.look(middle)[1].all()
    near = np.linalg.norm(at[inside][:-1] - at[inside][1:], axis=1) < 1e-3
    assert (np.linalg.norm(seen[:-1] - seen[1:], axis=1)[near] < 2.0).all()


def test_sightings_are_the_maximal_stays() -> None:
    rng = np.random.default_rng(5)
    view, size = piece(rng)
    knots = [
        walk(list(rng.uniform((0, 0), size, (9, 2))), [0, 5, *[0] * 7], 1.3, 3.0 * k, rng)
        for k in range(12)
    ]
    walks = sampled(knots, size, 0.5, 150.0)
    seen = sightings([view], walks, np.inf, rng)
    expected = []
    for who in range(12):
        mine = walks.who == who
        begun, last = None, 0.0
        for t, inside in [
            *zip(walks.t[mine], view.look(walks.floor[mine])[1], strict=True),
            (np.inf, False),
        ]:
            if inside and begun is None:
                begun = t
            if not inside and begun is not None:
                expected.append((who, begun, last))
                begun = None
            last = t
    assert sorted(zip(seen.who.tolist(), seen.t_in, seen.t_out, strict=True)) == sorted(expected)
    assert len(expected) > 5


def test_a_walk_takes_its_time() -> None:
    rng = np.random.default_rng(6)
    stops = [np.array((0.0, 5.0)), np.array((13.0, 5.0)), np.array((13.0, 18.0))]
    seconds = [walk(stops, [0.0, 30.0, 0.0], 1.3, 100.0, rng)[0] for _ in range(200)]
    assert all((np.diff(t) > 0).all() and t[0] == 100.0 for t in seconds)
    assert np.mean([t[-1] for t in seconds]) == pytest.approx(100 + 20 + 30, rel=0.01)


def one_stay() -> Sightings:
    zero = np.zeros(1, dtype=np.int64)
    return Sightings(
        zero,
        zero,
        np.array([10.0]),
        np.array([20.0]),
        np.array([[0.0, 0.5]]),
        np.array([[1.0, 0.5]]),
        zero,
        zero + 1,
    )


def test_a_recording_that_begins_late_has_the_rest() -> None:
    cut = clipped(one_stay(), [(0, 0.0, 12.5), (0, 15.0, 99.0), (1, 0.0, 99.0)])
    assert cut.t_in.tolist() == [10.0, 15.0]
    assert cut.t_out.tolist() == [12.5, 20.0]
    assert cut.at_out[0].tolist() == [0.25, 0.5]
    assert cut.at_in[1].tolist() == [0.5, 0.5]
    assert cut.zone_in.tolist() == [0, -1]
    assert cut.zone_out.tolist() == [-1, 1]


def test_a_broken_track_is_two() -> None:
    parts = broken(one_stay(), 1e-3, np.random.default_rng(0))
    assert len(parts.who) == 2
    gap = parts.t_in[1] - parts.t_out[0]
    assert 0 < gap <= 3.0
    assert parts.at_in[1, 0] - parts.at_out[0, 0] == pytest.approx(gap / 10)
    assert len(broken(one_stay(), np.inf, np.random.default_rng(0)).who) == 1


def test_nobody_makes_an_empty_recording() -> None:
    nobody = one_stay().take(np.zeros(0, dtype=np.int64))
    events, truth = recorded(["a"], nobody, nobody, Faults(), 0.0, np.random.default_rng(0))
    assert events == []
    assert truth.links == truth.pairs == truth.zones == []
    assert sampled([], (1.0, 1.0), 0.5, 10.0).who.size == 0
    assert isinstance(sampled([], (1.0, 1.0), 0.5, 10.0), Walks)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(
    "wrong", [{"seconds": 0.0}, {"cameras": 0}, {"faults": Faults(missed=1.0)}]
)
def test_settings_without_sense_are_refused(scene: str, wrong: dict[str, object]) -> None:
    simulate, chosen = SIMULATE[scene]
    with pytest.raises(ValueError, match="missed" if "faults" in wrong else next(iter(wrong))):
        simulate(msgspec.structs.replace(chosen, **wrong))


def test_too_many_cameras_are_refused() -> None:
    with pytest.raises(ValueError, match="arterials"):
        simulate_road(RoadSettings(cameras=200))
    with pytest.raises(ValueError, match="no 3 views"):
        make_pieces(
            (30.0, 20.0), ["a", "b", "c"], (0.9999, 1.0), (0.0, 0.0), np.random.default_rng(0)
        )
