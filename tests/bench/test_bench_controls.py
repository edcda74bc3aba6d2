"""Controls: the recordings are what they say, and false links are told from right ones."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from support.synthetic_events import learned_from

from bench import controls
from bench.support.control_recordings import (
    CYCLE_SECONDS,
    GREEN_SHARE,
    LIGHTS,
    RHYTHMS,
    Street,
    Traffic,
    TwoSites,
    after_light,
)
from camtopod.records import Event


def entries(events: list[Event], camera: str) -> np.ndarray:
    return np.array([e.t for e in events if e.camera == camera and e.kind == "entry"])


@pytest.mark.parametrize("rhythm", RHYTHMS)
@pytest.mark.parametrize("doors", [0, 3])
def test_traffic_has_its_cameras_rate_and_length(rhythm: str, doors: int) -> None:
    traffic = Traffic(3, 10.0, 60.0, doors=doors, rhythm=rhythm)

    events = traffic.record(1)

    count = Counter(event.camera for event in events)
    assert sorted(count) == ["c1", "c2", "c3"]
    assert all(0.75 * 2 * 600 < each < 1.25 * 2 * 600 for each in count.values())
    assert events == sorted(events, key=lambda event: event.t)
    assert events[-1].t - events[0].t <= 3600.0
    assert all((event.x is None) == (doors == 0) for event in events)
    assert events == traffic.record(1) != traffic.record(2)


def test_bells_have_their_period() -> None:
    t = entries(Traffic(rhythm="bells", minutes=60.0).record(1), "c1")

    assert abs(np.exp(2j * np.pi * t / CYCLE_SECONDS).mean()) > 0.7


def test_a_batch_reaches_all_cameras() -> None:
    events = Traffic(rhythm="batches", minutes=60.0, cycle=300.0).record(1)

    edges = np.arange(events[0].t, events[-1].t, 60.0)
    counts = [np.histogram(entries(events, camera), edges)[0] for camera in ("c1", "c2")]
    assert np.corrcoef(counts)[0, 1] > 0.7


def test_nothing_passes_a_red_light() -> None:
    chance, changes = np.random.default_rng(1), np.arange(0.0, 1000.0, 100.0)
    t = chance.uniform(0.0, 800.0, 500)

    passed = after_light(t, changes, chance)

    assert (passed >= t).all()
    assert (passed % 100.0 <= 100.0 * GREEN_SHARE).all()
    assert (passed - t < 100.0 * (1.0 + GREEN_SHARE)).all()


@pytest.mark.parametrize("light", LIGHTS)
def test_objects_go_on_along_a_street_whatever_its_lights(light: str) -> None:
    street = Street(light, 1.0)
    assert street.ways["c1", "c2"] == street.ways["c2", "c1"] == 29.0

    events = street.record(1)

    out = np.array([e.t for e in events if e.camera == "c1" and e.kind == "exit"])
    lags = np.subtract.outer(entries(events, "c2"), out).ravel()
    on_way = np.count_nonzero(abs(lags - 29.0) < 5.0) / 10.0
    beside = np.count_nonzero(abs(lags + 29.0) < 5.0) / 10.0
    assert on_way > 1.5 * beside


def test_two_sites_share_no_camera_and_no_way() -> None:
    sites = TwoSites(minutes=10.0)

    assert {event.camera[:4] for event in sites.record(1)} == {"east", "west"}
    assert len(sites.ways) == 12
    assert all(source[:4] == target[:4] for source, target in sites.ways)


def test_links_beside_the_ways_are_false() -> None:
    street = Street(per_minute=2.0, minutes=90.0)
    topology = learned_from(street.record(1))
    some = {pair: way for pair, way in street.ways.items() if pair[0] < pair[1]}
    shifted = {pair: way + 20.0 for pair, way in street.ways.items()}

    outcome = controls.judge(topology, street.ways, 1)
    half = controls.judge(topology, some, 1)
    late = controls.judge(topology, shifted, 1)

    assert (outcome.right, outcome.false) == (6, [])
    assert half.right == 3
    assert len(half.false) >= 3
    assert half.least_q < 0.01 < outcome.least_q
    assert late.right == 0


def test_the_table_names_every_false_link(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    quiet = Traffic(2, 2.0, 10.0)
    monkeypatch.setattr(controls, "controls", lambda: {"steady": {"quiet": quiet}})

    assert controls.main(["--runs", "2", "--jobs", "1", "--kinds", "steady"]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[:1] == ["quiet"]
    assert "0 false links in 2 recordings" in lines[2]
    with pytest.raises(SystemExit):
        controls.main(["--kinds", "loud"])
    assert "no loud; choose from steady, cages" in capsys.readouterr().err


def test_all_controls_have_titles_of_their_own() -> None:
    every = [title for kind in controls.controls().values() for title in kind]

    assert len(set(every)) == len(every) > 40
