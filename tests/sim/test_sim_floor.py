"""The demo's site: geometry, walks, pictures and ground truth."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from synthetic_events import topology_of

from camtopod.sim.floor import (
    FPS,
    HEIGHT,
    WIDTH,
    View,
    demo_plan,
    passages,
    simulate_walks,
    truth_of,
)
from camtopod.sim.picture import write_map
from camtopod.sim.rendering import SUFFIX, render, scene
from camtopod.sim.scoring import score

PLAN = demo_plan()
WALKS = simulate_walks(PLAN, 600.0, 0.1, np.random.default_rng(3))
TRUTH = truth_of(PLAN, passages(PLAN, WALKS))


@pytest.mark.parametrize("heading", [0.0, -2.5])
def test_a_view_looks_at_its_target_and_sees_its_footprint(heading: float) -> None:
    view = View("c", (3.0, -2.0), heading)
    ahead = np.array((math.cos(heading), math.sin(heading)))
    right = np.array((ahead[1], -ahead[0]))

    [target, farther, beside] = view.feet(view.target + np.array([(0, 0), ahead, right]))

    assert target == pytest.approx((0.5, 0.5, math.hypot(view.height, view.distance)))
    assert farther[1] < 0.5, "farther away is higher up"
    assert beside[0] > 0.5, "its right is on the right"
    corners = view.feet(view.footprint())[:, :2]
    assert corners == pytest.approx(np.array([(0, 0), (1, 0), (1, 1), (0, 1)]), abs=1e-4)


def test_truth_is_what_was_walked() -> None:
    assert TRUTH.cameras == [view.camera for view in PLAN.views]
    assert all(sum(z.camera == c for z in TRUTH.zones) == 3 for c in TRUTH.cameras)
    assert {pair.cameras: pair.relation for pair in TRUTH.pairs} == {
        ("entrance", "hall"): "overlapped",
        ("corridor", "garden"): "overlapped",
        ("cafe", "corridor"): "unseen_path",
        ("cafe", "hall"): "unseen_path",
        ("corridor", "hall"): "unseen_path",
        ("entrance", "garden"): "unseen_path",
    }
    assert len(TRUTH.links) == 12
    for link in TRUTH.links:
        assert (link.transit.mean < 0) == (link.relation == "overlapped")
        leaving = [other.probability for other in TRUTH.links if other.from_ == link.from_]
        assert sum(leaving) <= 1 + 1e-9
    assert score(topology_of(TRUTH), TRUTH).link_recall == 1


def test_video_shows_people_where_the_truth_says(tmp_path: Path) -> None:
    view, path = PLAN.views[0], tmp_path / f"v{SUFFIX}"

    render(PLAN, view, WALKS, 20.0, path, seed=0)

    # Pixels that differ from the empty scene, by frame.
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(FPS)
    empty = scene(PLAN, view).astype(np.int16)
    changed = []
    while (frame := capture.read())[0]:
        assert frame[1].shape == (HEIGHT, WIDTH, 3)
        changed.append(int((np.abs(frame[1] - empty).max(axis=2) > 60).sum()))
    capture.release()
    assert len(changed) == round(20 * FPS)

    # Frames with somebody in view, and well inside of it.
    inside = np.zeros(len(changed), dtype=bool)
    well_inside = inside.copy()
    for walk in WALKS:
        frames = np.round(walk.t * FPS).astype(int)
        early = frames < len(changed)
        x, y, _ = view.feet(walk.floor[early]).T
        inside[frames[early][view.sees(walk.floor[early])]] = True
        well_inside[frames[early][(x > 0.1) & (x < 0.9) & (y > 0.3) & (y < 0.95)]] = True
    assert well_inside.sum() > 20
    assert np.array(changed)[well_inside].min() > 30
    assert np.array(changed)[~inside].max() < 30


def test_a_video_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="cannot write the video"):
        render(PLAN, PLAN.views[0], [], 1.0, tmp_path / "no" / f"v{SUFFIX}", seed=0)


def test_picture_is_drawn_even_when_nothing_was_learned(tmp_path: Path) -> None:
    perfect = topology_of(TRUTH)
    nothing = msgspec.structs.replace(perfect, zones=[], links=[])

    write_map(tmp_path / "a.png", PLAN, TRUTH, perfect, ["note"])
    write_map(tmp_path / "b.png", PLAN, TRUTH, nothing, ["note"])

    full, empty = (cv2.imread(str(tmp_path / name)) for name in ("a.png", "b.png"))
    half = full.shape[1] // 2
    assert full.shape == empty.shape
    assert half > 600
    assert (empty[:500, :half] == full[:500, :half]).all(), "the true map is the same"
    assert (empty[:500, half:] != full[:500, half:]).any()
