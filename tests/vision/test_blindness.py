"""Where nothing can be told from the pictures the view is blind, says why, and makes no events."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Picture, Place, Scene, line

from camtopod.records import Event
from camtopod.vision.blindness import REASONS
from camtopod.vision.grabber import Grabber
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

RNG = np.random.default_rng(7)


def noise(level: float, sigma: float) -> Picture:
    return RNG.normal(level, sigma, (HEIGHT, WIDTH)).clip(0, 255).astype(np.uint8)


def walker(t: float, seed: int) -> Person:
    return Person(line(t, (-0.05, 0.8), (1.05, 0.8), 6.0), tall=0.35, seed=seed)


def watch(
    picture: Callable[[float], Picture], seconds: float
) -> tuple[list[Event], dict[int, str], ViewPipeline]:
    """Return events, the reason for blindness by the second, and the pipeline."""
    pipeline = ViewPipeline("cam", VisionSettings())
    events, reasons = [], {}
    for k in range(round(seconds * FPS)):
        events += pipeline.process(k / FPS, picture(k / FPS))
        reasons[int(k / FPS)] = pipeline.reason
    return events + pipeline.finish(), reasons, pipeline


@pytest.mark.parametrize(
    "nothing",
    [
        lambda t, scene: noise(0, 0),
        lambda t, scene: noise(16, 2),
        lambda t, scene: noise(255, 3),
        lambda t, scene: noise(120, 6),
        lambda t, scene: noise(12, 5) + scene // 16,
    ],
    ids=["black", "covered", "white", "grey", "darkness"],
)
def test_a_view_that_shows_nothing_is_blind_until_it_shows_something(
    nothing: Callable[[float, Picture], Picture],
) -> None:
    scene = Scene([walker(8.0, 1), walker(34.0, 2), walker(62.0, 3)])

    def picture(t: float) -> Picture:
        return nothing(t, scene.picture(t)) if 20.0 < t < 50.0 else scene.picture(t)

    events, reasons, pipeline = watch(picture, 72.0)
    assert [event.kind for event in events] == ["entry", "exit"] * 2
    assert all(event.t < 20.0 or event.t > 60.0 for event in events)
    assert not any(reasons[second] for second in range(20))
    assert all(reasons[second] == REASONS["contrast"] for second in range(30, 50))
    assert not any(reasons[second] for second in range(60, 72))
    assert pipeline.statistics()["blind_seconds"] == pytest.approx(30.0, abs=5.0)


def test_what_is_in_view_when_the_view_goes_blind_and_sees_again_makes_no_events() -> None:
    def strolls(t: float) -> Place | None:
        come_in = (-0.05 + 0.55 * (t - 24.0) / 4.0, 0.8)
        return come_in if t < 28.0 else (0.5 + 0.3 * math.sin((t - 28.0) / 2.0), 0.8)

    scene = Scene([Person(strolls, tall=0.35)])

    def picture(t: float) -> Picture:
        return noise(10, 1) if 30.0 < t < 60.0 else scene.picture(t)

    events, _, _ = watch(picture, 85.0)
    assert [event.kind for event in events] == ["entry"]


def test_a_dark_scene_without_noise_is_seen() -> None:
    scene = Scene([walker(8.0, 1)], noise=0.3, light=lambda t: 0.15)
    _, reasons, _ = watch(scene.picture, 20.0)
    assert not any(reasons.values())


def test_a_camera_that_turns_is_blind_until_it_stands_still() -> None:
    views = [Scene([], rng=np.random.default_rng(seed)) for seed in range(3)]

    def picture(t: float) -> Picture:
        return views[int(min(t, 59.0) // 12) % 3].picture(t)

    events, reasons, _ = watch(picture, 75.0)
    assert events == []
    assert not any(reasons[second] for second in range(36))  # two changes
    assert all(reasons[second] == REASONS["turning"] for second in (43, 44, 55, 56))
    assert not any(reasons[second] for second in range(69, 75))


def test_blind_is_a_state_of_the_grabber(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("camtopod.vision.grabber.HEARTBEAT_SECONDS", 0.0)
    film = Scene([], front=lambda picture: picture.fill(20)).film(tmp_path / "film.mp4", 20.0)
    grabber = Grabber("cam", str(film), wall_clock=lambda: 0.0)
    states = {}
    for _ in grabber.events():
        states[grabber.state] = grabber.reason
    assert states["running"] == ""
    assert states["blind"].startswith(REASONS["contrast"])
    assert grabber.state == "ended"
