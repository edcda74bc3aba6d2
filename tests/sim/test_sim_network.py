"""The simulated network has the stated properties."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bench.support.prediction_scores import next_entries
from camtopod.cli.main import main
from camtopod.codec import event_from_json, to_json
from camtopod.sim.layout import ZONE_SEPARATION, make_layout
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import Truth

SMALL = st.builds(
    SimSettings,
    cameras=st.integers(1, 15),
    hours=st.floats(0.05, 0.3),
    seed=st.integers(0, 10_000),
    missed=st.floats(0, 0.5),
    clutter=st.floats(0, 0.5),
    loiterers=st.floats(0, 0.3),
    slow_share=st.floats(0, 1),
    rhythm=st.floats(0, 1),
    doors_closed=st.integers(0, 3),
    doors_opened=st.integers(0, 3),
    overlap_share=st.floats(0, 1),
    linked=st.booleans(),
)


@settings(max_examples=10, deadline=None)
@given(SMALL)
def test_every_setting_gives_a_consistent_recording(chosen: SimSettings) -> None:
    events, truth = simulate(chosen)

    # Events.
    assert len(events) == len(truth.identity) == len(truth.passage) == len(truth.zone)
    assert [e.t for e in events] == sorted(e.t for e in events)
    for event in events:
        assert event_from_json(to_json(event)) == event
    owned = [
        (event.camera, who, number, event.kind)
        for event, who, number in zip(events, truth.identity, truth.passage, strict=True)
        if who >= 0
    ]
    assert len(set(owned)) == len(owned)
    assert {(c, w, n, "exit") for c, w, n, kind in owned if kind == "entry"} == {
        one for one in owned if one[3] == "exit"
    }, "a passage is recorded whole or not at all"

    # Zones and the probabilities of links.
    assert {zone.camera for zone in truth.zones} == set(truth.cameras)
    for zone in truth.zones:
        leaving = [link for link in truth.links if link.from_ == zone.id]
        inside = sum(link.probability for link in leaving if link.relation == "visible")
        onward = sum(link.probability for link in leaving if link.relation != "visible")
        assert inside == pytest.approx(1, abs=1e-5)
        assert onward <= 1 + 1e-5


@settings(max_examples=2, deadline=None)
@given(SMALL)
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

    # Transit times and departures by zone.
    lags: dict[tuple[str, str], list[float]] = {}
    exits: Counter[str] = Counter()
    for i, j in enumerate(next_entries(events, truth)):
        zone = truth.zones[truth.zone[i]].id
        exits[zone] += events[i].kind == "exit"
        if j >= 0:
            onward = truth.zones[truth.zone[j]].id
            lags.setdefault((zone, onward), []).append(events[j].t - events[i].t)

    checked = 0
    for link in truth.links:
        seen = lags.get((link.from_, link.to), [])
        if link.relation != "visible" and len(seen) >= 300:
            checked += 1
            assert len(seen) == link.transitions
            assert len(seen) / exits[link.from_] == pytest.approx(link.probability, abs=0.08)
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
            assert all(np.linalg.norm(a - b) >= ZONE_SEPARATION for b in centres[:i])
    reached, edge = {0}, [0]
    while edge:
        zones = np.flatnonzero(layout.camera == edge.pop())
        targets = layout.onward.target[zones][layout.onward.probability[zones] > 0]
        fresh = {int(c) for c in layout.camera[targets]} - reached
        reached |= fresh
        edge += fresh
    assert reached == set(range(cameras))


def test_two_zones_lead_outside_and_never_all_of_a_camera() -> None:
    for cameras, seed in ((2, 34), (3, 34), (4, 37), (4, 40), (5, 0)):
        layout = make_layout(cameras, np.random.default_rng(seed), 0.25)
        is_street = layout.arrivals > 2 * layout.arrivals.min()
        street_cameras = layout.camera[is_street]
        zones, streets = np.bincount(layout.camera), np.bincount(street_cameras, minlength=cameras)
        assert len(street_cameras) >= 2
        assert (streets < zones).all()


@pytest.mark.parametrize("closed", [True, False])
def test_nobody_passes_a_closed_door(closed: bool) -> None:
    doors = {"doors_closed": 2} if closed else {"doors_opened": 2}
    events, truth = simulate(SimSettings(hours=2, seed=5, clutter=0, missed=0, **doors))

    changed = {
        (link.from_, link.to): link.closed_at or link.opened_at
        for link in truth.links
        if link.closed_at or link.opened_at
    }
    assert len(changed) == 4
    passed = {True: 0, False: 0}
    for i, j in enumerate(next_entries(events, truth)):
        ends = truth.zones[truth.zone[i]].id, truth.zones[truth.zone[j]].id
        if j >= 0 and ends in changed:
            passed[(events[i].t < changed[ends]) == closed] += 1
    assert passed[True] > 20
    assert passed[False] == 0


def test_without_links_everybody_is_at_one_camera_only() -> None:
    events, truth = simulate(SimSettings(hours=1, linked=False, rhythm=0.5, objects_per_second=0.5))

    pairs = zip(events, truth.identity, strict=True)
    seen = {(who, event.camera) for event, who in pairs if who >= 0}
    assert len(seen) == len({who for who, _ in seen}) > 300
    assert {link.relation for link in truth.links} == {"visible"}
    assert truth.pairs == []
    assert max(next_entries(events, truth)) == -1


def test_rhythm_moves_people_into_the_day() -> None:
    events, _ = simulate(SimSettings(hours=24, cameras=3, rhythm=0.9, start=0.0, clutter=0))

    noon = sum(10 < e.t / 3600 < 14 for e in events)
    night = sum(e.t / 3600 < 2 or e.t / 3600 > 22 for e in events)
    assert noon > 5 * night


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
    for option, value in (("missed", "7"), ("clutter", "1"), ("cameras", "0"), ("seed", "-1")):
        assert main(["simulate", "--events", "-", f"--{option}", value]) == 2
        assert f"$.{option}" in capsys.readouterr().err

    assert main(["simulate", "--hours", "0.01", "--events", str(tmp_path / "no" / "e")]) == 1
    assert "cannot write" in capsys.readouterr().err


def test_walkers_have_labels_by_their_shares() -> None:
    """The events are those without labels otherwise; clutter has none."""
    plain = SimSettings(cameras=6, hours=0.5, seed=4)
    labels = {"person": 0.6, "car": 0.3}
    events, truth = simulate(msgspec.structs.replace(plain, labels=labels))

    without, _ = simulate(plain)
    assert [msgspec.structs.replace(event, label=None) for event in events] == without
    of: dict[int, set[str | None]] = {}
    for event, walker in zip(events, truth.identity, strict=True):
        of.setdefault(walker, set()).add(event.label)
    assert of.pop(-1) == {None}
    assert {len(some) for some in of.values()} == {1}
    drawn = [next(iter(some)) for some in of.values()]
    assert drawn.count("person") / len(drawn) == pytest.approx(0.6, abs=0.08)
    assert drawn.count(None) / len(drawn) == pytest.approx(0.1, abs=0.05)
    with pytest.raises(ValueError, match="more than 1"):
        simulate(msgspec.structs.replace(plain, labels={"person": 0.6, "car": 0.5}))
