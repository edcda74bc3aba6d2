"""`bench demo` at a small size: floor plans drawn from a seed, and the demo without its bus."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from bench import demo
from bench.scenes.drawn_plan import APART_MIN, CAMERAS, drawn_plan
from camtopod.records import Zone
from camtopod.sim.floor import passages, simulate_walks, truth_of


def test_a_seed_draws_a_plan_whose_zones_are_apart() -> None:
    plan = drawn_plan(1)
    assert plan == drawn_plan(1)
    assert plan != drawn_plan(2)
    assert len(plan.views) == CAMERAS
    assert len(plan.streets()) >= 3
    walks = simulate_walks(plan, 600.0, 0.1, np.random.default_rng(1))
    truth = truth_of(plan, passages(plan, walks))
    for camera in truth.cameras:
        zones = [(zone.x, zone.y) for zone in truth.zones if zone.camera == camera]
        assert len(zones) >= 2
        for a, b in combinations(np.array(zones, dtype=float), 2):
            assert np.linalg.norm(a - b) >= APART_MIN


def test_a_site_is_recorded_seen_and_learned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--seeds", "1", "--plans", "0", "--minutes", "2.5", "--films", str(tmp_path)]
    assert demo.main(arguments) == 0
    head, line, *_, last = capsys.readouterr().out.splitlines()
    assert head.split()[:2] == ["site", "events"]
    assert line.startswith("demo, seed 1")
    events, true, learned, matched = map(int, line.split()[3:7])
    assert events > 60
    assert true == 15
    assert abs(learned - true) <= 5, "some minutes tell of few passages"
    assert matched >= 10
    assert last in ("0 of 1 sites with all zones right", "1 of 1 sites with all zones right")
    assert len(list(tmp_path.glob("demo-1/*.mp4"))) == 5


def test_wrong_zones_are_named() -> None:
    plan = drawn_plan(1)
    walks = simulate_walks(plan, 300.0, 0.1, np.random.default_rng(1))
    truth = truth_of(plan, passages(plan, walks))
    zones = [
        Zone(id=zone.id, camera=zone.camera, x=zone.x, y=zone.y, entries=5, exits=4)
        for zone in truth.zones[1:]
    ]
    elsewhere = Zone(id="camera1/9", camera="camera1", x=0.25, y=0.25, entries=2, exits=1)
    missing = truth.zones[0]
    assert demo.wrong_zones([*zones, elsewhere], truth) == [
        f"    missing: {missing.camera} at ({missing.x:.2f}, {missing.y:.2f})",
        "    not there: camera1 at (0.25, 0.25), 2 entries, 1 exits",
    ]
