"""Scenery that sways is no object, and hides nobody who walks past it."""

from __future__ import annotations

import numpy as np
import pytest
from rendered_scenes import FPS, Person, Scene, line

from bench.support.clip_variants import Bush
from camtopod.vision.detect.swaying import SWAY_SECONDS, SWAY_START_SECONDS, Swaying
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

SECONDS = 60.0


def windy(people: list[Person]) -> list[tuple[str, float]]:
    """Return kind and time of the events of a scene with a bush at its left border."""
    scene, pipeline = Scene(people), ViewPipeline("cam", VisionSettings())
    bush = Bush(60, 60, gust=2.0)
    events = []
    for k in range(round(SECONDS * FPS)):
        picture = scene.picture(k / FPS)
        bush.draw(picture[20:80, :60], k / FPS)
        events += pipeline.process(k / FPS, picture)
    return [(event.kind, event.t) for event in events + pipeline.finish()]


def test_nobody_enters_out_of_a_bush_in_the_wind() -> None:
    assert windy([]) == []


def test_who_walks_past_it_is_seen() -> None:
    walker = Person(line(30.0, (-0.05, 0.85), (1.05, 0.85), 8.0), shade=20)
    (entry, entered), (leaving, left) = windy([walker])
    assert (entry, leaving) == ("entry", "exit")
    assert entered == pytest.approx(30.3, abs=0.7)
    assert left == pytest.approx(37.7, abs=0.7)


@pytest.mark.parametrize("seed", range(3))
def test_swaying_pixels_beside_a_slow_version(seed: int) -> None:
    """The mean of the changes, pixel by pixel, and the range of a neighbourhood."""
    rng = np.random.default_rng(seed)
    high, wide, dt, least = 20, 30, 0.15, 25.0
    swaying = Swaying((high, wide))
    rates = rng.uniform(0.0, 0.5, (high, wide))
    differed, share, seconds = np.zeros((high, wide), bool), np.zeros((high, wide)), 0.0
    for _ in range(80):
        differs, free = differed ^ (rng.uniform(size=(high, wide)) < rates), rates < 0.45
        swaying.learn(mask(differs), dt, mask(free))
        seconds += dt
        weight = dt / min(max(seconds, SWAY_START_SECONDS), SWAY_SECONDS)
        share = np.where(free, share + weight * ((differs ^ differed) - share), share)
        differed = differs

    frame, expected = rng.integers(0, 256, (2, high, wide), np.uint8)
    moving = np.abs(frame.astype(int) - expected) > least
    kept = swaying.without(mask(moving), frame, expected, least) != 0
    for y, x in np.ndindex(high, wide):
        near = share[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
        scene = expected[max(0, y - 3) : y + 4, max(0, x - 3) : x + 4].astype(int)
        inside = scene.min() - least <= int(frame[y, x]) <= scene.max() + least
        assert kept[y, x] == (moving[y, x] and not (inside and (near > 0.15).any()))


def mask(where: np.typing.NDArray[np.bool_]) -> np.typing.NDArray[np.uint8]:
    return np.where(where, np.uint8(255), np.uint8(0))
