"""The simulated network has the stated properties."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from camtopod.cli.main import main
from camtopod.codec import event_from_json, to_json
from camtopod.records import Event
from camtopod.sim.layout import ZONE_SEPARATION, make_layout
from camtopod.sim.scoring import next_entries
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import Truth

small = st.builds(
    SimSettings,
    cameras=st.integers(1, 15),
    hours=st.floats(0.05, 0.3),
    seed=st.integers(0, 10_000),
    missed=st.floats(0, 0.5),
    clutter=st.floats(0, 0.5),
    group_share=st.floats(0, 0.5),
    loiterers=st.floats(0, 0.3),
    slow_share=st.floats(0, 1),
    rhythm=st.floats(0, 1),
    clock_sd=st.floats(0, 2),
    doors_closed=st.integers(0, 3),
    doors_opened=st.integers(0, 3),
    clock_max=st.floats(0, 30),
    overlap_share=st.floats(0, 1),
    platoons=st.floats(0, 1),
    uneven=st.floats(0, 0.5),
    one_way=st.floats(0, 1),
    fire_doors=st.integers(0, 3),
    linked=st.booleans(),
    zone_separation=st.floats(0.1, 0.3),
    zone_stretch=st.floats(1, 4),
    tracks=st.booleans(),
    positions=st.booleans(),
)


@settings(max_examples=10, deadline=None)
@given(small)
def test_every_setting_gives_a_consistent_recording(chosen: SimSettings) -> None:
    events, truth = simulate(chosen)
    assert len(events) == len(truth.identity) == len(truth.passage) == len(truth.zone)
    assert [e.t for e in events] == sorted(e.t for e in events)
    for event in events:
        assert event_from_json(to_json(event)) == event
        assert (event.x is None) == (not chosen.positions)
    owned = [
        (e, who, n)
        for e, who, n in zip(events, truth.identity, truth.passage, strict=True)
        if who >= 0
    ]
    halves = Counter((e.camera, who, n) for e, who, n in owned)
    assert set(halves.values()) <= {2}, "a passage is recorded whole or not at all"
    assert sum(e.kind == "entry" for e, _, _ in owned) * 2 == len(owned)
    assert {zone.camera for zone in truth.zones} == set(truth.cameras)
    for zone in truth.zones:
        leaving = [link for link in truth.links if link.from_ == zone.id]
        for inside in (True, False):
            total = sum(x.probability for x in leaving if (x.relation == "visible") == inside)
            assert total <= 1 + 1e-5
            assert not inside or total == pytest.approx(1, abs=1e-5)


@settings(max_examples=2, deadline=None)
@given(small)
def test_same_seed_same_events(chosen: SimSettings) -> None:
    assert simulate(chosen) == simulate(chosen)


def test_missed_and_clutter_have_the_shares_asked_for() -> None:
    whole, truth = simulate(SimSettings(hours=1, missed=0, clutter=0))
    assert min(truth.identity) >= 0
    events, truth = simulate(SimSettings(hours=1, missed=0.2, clutter=0.25))
    clutter = sum(who < 0 for who in truth.identity)
    assert clutter / len(events) == pytest.approx(0.25, abs=0.001)
    assert (len(events) - clutter) / len(whole) == pytest.approx(0.8, abs=0.02)


def test_walks_have_the_truths_probabilities_and_times() -> None:
    """The ground truth equals a naive count from identities."""
    events, truth = simulate(SimSettings(hours=6, missed=0, clutter=0, seed=3))
    following = next_entries(events, truth)
    lags: dict[tuple[int, int], list[float]] = {}
    exits: Counter[int] = Counter()
    for i, j in enumerate(following):
        if events[i].kind == "exit":
            exits[truth.zone[i]] += 1
        if j >= 0:
            lags.setdefault((truth.zone[i], truth.zone[j]), []).append(events[j].t - events[i].t)
    index = {zone.id: k for k, zone in enumerate(truth.zones)}
    checked = 0
    for link in truth.links:
        seen = lags.get((index[link.from_], index[link.to]), [])
        if link.relation == "visible" or len(seen) < 300:
            continue
        checked += 1
        assert len(seen) == link.transitions
        assert len(seen) / exits[index[link.from_]] == pytest.approx(link.probability, abs=0.08)
        assert np.mean(seen) == pytest.approx(link.transit.mean, rel=0.1)
        assert np.quantile(seen, 0.9) == pytest.approx(link.transit.q90, rel=0.15)
        assert (np.mean(seen) < 0) == (link.relation == "overlapped")
    assert checked > 10


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 60), st.integers(0, 1000))
def test_zones_can_be_told_apart_and_all_cameras_hang_together(cameras: int, seed: int) -> None:
    layout = make_layout(cameras, np.random.default_rng(seed), 0.25)
    assert np.isclose(layout.arrivals.sum(), 1)
    for c in range(cameras):
        centres = layout.centre[layout.camera == c]
        assert 2 <= len(centres) <= 5
        for i, a in enumerate(centres):
            for b in centres[:i]:
                assert np.linalg.norm(a - b) >= ZONE_SEPARATION
    reached, edge = {0}, [0]
    while edge:
        zones = np.flatnonzero(layout.camera == edge.pop())
        onward = layout.onward
        targets = onward.target[zones][onward.probability[zones] > 0]
        fresh = {int(c) for c in layout.camera[targets]} - reached
        reached |= fresh
        edge += fresh
    assert reached == set(range(cameras))


def test_doors_close() -> None:
    events, truth = simulate(SimSettings(hours=2, seed=5, doors_closed=2, clutter=0, missed=0))
    closed = {
        (link.from_, link.to): link.closed_at for link in truth.links if link.closed_at is not None
    }
    assert len(closed) == 4
    before = after = 0
    for i, j in enumerate(next_entries(events, truth)):
        if j >= 0:
            key = truth.zones[truth.zone[i]].id, truth.zones[truth.zone[j]].id
            before += key in closed and events[i].t < closed[key]
            after += key in closed and events[i].t >= closed[key]
    assert before > 20
    assert after == 0


def test_without_links_everybody_is_at_one_camera_only() -> None:
    events, truth = simulate(SimSettings(hours=1, linked=False, rhythm=0.5, objects_per_second=0.5))
    seen: dict[int, set[str]] = {}
    for event, who in zip(events, truth.identity, strict=True):
        seen.setdefault(who, set()).add(event.camera)
    del seen[-1]
    assert len(seen) > 300
    assert all(len(cameras) == 1 for cameras in seen.values())
    assert {link.relation for link in truth.links} == {"visible"}
    assert truth.pairs == []
    assert max(next_entries(events, truth)) == -1


def test_platoons_come_in_bunches() -> None:
    def arrivals(share: float) -> tuple[list[float], Counter[tuple[int, int]]]:
        events, truth = simulate(
            SimSettings(hours=2, platoons=share, missed=0, clutter=0, platoon_size=8)
        )
        first = [
            (e.t, zone)
            for e, n, zone in zip(events, truth.passage, truth.zone, strict=True)
            if n == 0 and e.kind == "entry"
        ]
        return [t for t, _ in first], Counter((int(t // 15), zone) for t, zone in first)

    alone, alone_together = arrivals(0.0)
    times, together = arrivals(0.9)
    assert len(times) == pytest.approx(len(alone), rel=0.1)
    assert max(alone_together.values()) <= 5
    assert sum(n for n in together.values() if n >= 5) > 0.4 * len(times)


def test_a_turned_camera_shows_its_zones_elsewhere() -> None:
    settings = SimSettings(hours=1, clutter=0, moved=(("cam02", 1800.0),))
    events, truth = simulate(settings)
    still, before = simulate(msgspec.structs.replace(settings, moved=()))
    assert [(e.camera, e.t) for e in events] == [(e.camera, e.t) for e in still]
    moved = [zone for zone in truth.zones if zone.moved_at is not None]
    assert {zone.camera for zone in moved} == {"cam02"}
    assert all(zone.moved_at == settings.start + 1800 for zone in moved)
    assert [zone.was for zone in moved] == [(z.x, z.y) for z in before.zones if z.camera == "cam02"]
    for index, zone in enumerate(truth.zones):
        for late in (False, True):
            at = [
                (e.x, e.y)
                for e, z in zip(events, truth.zone, strict=True)
                if z == index and (e.t >= settings.start + 1800) == late
            ]
            place = zone.was if zone.was is not None and not late else (zone.x, zone.y)
            if len(at) > 20:
                assert np.mean(np.array(at, dtype=float), 0) == pytest.approx(
                    np.array(place, dtype=float), abs=0.025
                )
                assert zone.cov is not None
                turned = np.cov(np.array(at, dtype=float).T)
                assert late is False or turned == pytest.approx(np.array(zone.cov), abs=0.001)
    shift = [
        np.hypot(z.x - z.was[0], z.y - z.was[1])
        for z in moved
        if z.was and z.x is not None and z.y is not None
    ]
    assert max(shift) > 0.2


def test_a_lost_camera_says_nothing_and_the_others_go_on() -> None:
    chosen = SimSettings(hours=0.5, lost=(("cam03", 600.0, 1200.0),))
    events, _ = simulate(chosen)
    whole, _ = simulate(msgspec.structs.replace(chosen, lost=()))

    def inside(e: Event) -> bool:
        return e.camera == "cam03" and 600 <= e.t - chosen.start < 1200

    assert any(inside(e) for e in whole)
    assert [(e.camera, e.t) for e in events] == [(e.camera, e.t) for e in whole if not inside(e)]


def test_clocks_are_off_by_what_the_truth_says() -> None:
    right, _ = simulate(SimSettings(hours=0.2, seed=4))
    wrong, truth = simulate(SimSettings(hours=0.2, seed=4, clock_sd=5.0))
    moved = sorted((e.camera, e.kind, e.t - truth.clock_offsets[e.camera]) for e in wrong)
    still = sorted((e.camera, e.kind, e.t) for e in right)
    assert [m[:2] for m in moved] == [s[:2] for s in still]
    assert np.allclose([m[2] for m in moved], [s[2] for s in still], atol=1e-5, rtol=0)
    assert max(abs(offset) for offset in truth.clock_offsets.values()) > 1


def test_rhythm_moves_people_into_the_day() -> None:
    events, _ = simulate(SimSettings(hours=24, cameras=3, rhythm=0.9, start=0.0, clutter=0))
    noon = sum(10 < e.t / 3600 < 14 for e in events)
    night = sum(e.t / 3600 < 2 or e.t / 3600 > 22 for e in events)
    assert noon > 5 * night


@pytest.mark.parametrize(
    "wrong",
    [
        {"missed": 1.5},
        {"clutter": 1.0},
        {"cameras": 0},
        {"lost": (("nowhere", 0.0, 1.0),)},
        {"seed": -1},
        {"moved": (("x", 1.0),)},
        {"uneven": -0.1},
    ],
)
def test_settings_without_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(
        ValueError, match="lose" if wrong.keys() & {"lost", "moved"} else next(iter(wrong))
    ):
        simulate(msgspec.structs.replace(SimSettings(hours=0.1), **wrong))


def test_command_writes_contract_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    events, truth = tmp_path / "e.jsonl", tmp_path / "t.json"
    files = ["--events", str(events), "--truth", str(truth)]
    assert main(["simulate", "--cameras", "4", "--hours", "0.1", "--seed", "7", *files]) == 0
    assert capsys.readouterr().out == ""
    read = [event_from_json(line) for line in events.read_bytes().splitlines()]
    assert (read, msgspec.json.decode(truth.read_bytes(), type=Truth)) == simulate(
        SimSettings(cameras=4, hours=0.1, seed=7)
    )
    assert main(["simulate", "--hours", "0.1", "--events", "-", "--start", "5"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[0])["t"] < 365


def test_command_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--events", "-", "--missed", "7"]) == 2
    assert "$.missed" in capsys.readouterr().err
    assert main(["simulate", "--hours", "0.01", "--events", str(tmp_path / "no" / "e")]) == 1
    assert "cannot write" in capsys.readouterr().err
