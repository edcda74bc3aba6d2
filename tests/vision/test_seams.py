"""Pictures put together of several views: objects enter and leave by the seams from the start."""

from __future__ import annotations

import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Picture, Place, Scene, line

from camtopod.records import Event
from camtopod.vision.detect.seams import find_tiles
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

SECONDS = 9.0
"""Time for each tile, in which a person crosses it."""


ACROSS = (-0.1, 0.9), (1.1, 0.9)
DOWN = (-0.1, 0.6), (0.7, 1.6)
LIGHT = (1.0, 0.5, 0.4, 0.8)
"""Brightness of the views."""


def scenes(count: int, way: tuple[Place, Place] = ACROSS) -> list[Scene]:
    """Return scenes that a person crosses, one after the other."""
    return [
        Scene(
            [
                Person(
                    line(5.0 + SECONDS * number, *way, 6.0),
                    tall=0.4,
                    shade=10,
                    seed=number,
                )
            ],
            light=lambda t, level=LIGHT[number]: level,
            rng=np.random.default_rng(number + 5),
        )
        for number in range(count)
    ]


def put_together(pictures: list[Picture], columns: int) -> Picture:
    """Return one picture of several, in rows of ``columns``."""
    rows = [np.hstack(pictures[k : k + columns]) for k in range(0, len(pictures), columns)]
    return np.vstack(rows)


def events_of(parts: list[Scene], columns: int) -> list[Event]:
    pipeline = ViewPipeline("cam", VisionSettings())
    events = []
    for k in range(round((5.0 + SECONDS * len(parts)) * FPS)):
        pictures = [scene.picture(k / FPS) for scene in parts]
        events += pipeline.process(k / FPS, put_together(pictures, columns))
    return events + pipeline.finish()


@pytest.mark.parametrize(("count", "columns", "way"), [(2, 2, ACROSS), (2, 1, DOWN), (4, 2, DOWN)])
def test_who_crosses_a_tile_enters_and_leaves_it(
    count: int, columns: int, way: tuple[Place, Place]
) -> None:
    events = events_of(scenes(count, way), columns)
    assert [event.kind for event in events] == ["entry", "exit"] * count


def test_a_scene_has_no_seam() -> None:
    """Nor has one with a thing in its middle, or a wall whose pattern goes on behind an edge."""
    [scene] = scenes(1)
    picture = scene.picture(0.0)
    shown = (0.0, 0.0, float(WIDTH), float(HEIGHT))
    assert find_tiles(picture, shown) == [shown]

    pole, wall = picture.copy(), np.repeat(picture[:, :1], WIDTH, axis=1)
    pole[: HEIGHT // 2, WIDTH // 2 - 2 : WIDTH // 2 + 2] = 10
    wall[:, WIDTH // 2 :] //= 2
    assert [find_tiles(image, shown) for image in (pole, wall)] == [[shown]] * 2

    two = np.hstack([picture, scenes(2)[1].picture(0.0)])
    tiles = find_tiles(two, (0.0, 0.0, 384.0, 144.0))
    assert tiles == [(0.0, 0.0, 190.0, 144.0), (194.0, 0.0, 384.0, 144.0)]
    narrow = (0.0, 0.0, WIDTH - 20.0, 144.0)
    assert find_tiles(two, narrow) == [narrow]


def test_the_seam_between_two_views_above_black_is_found() -> None:
    """As of a recorder for four cameras that has two."""
    pictures = [scene.picture(0.0) for scene in scenes(2)]
    black = np.zeros_like(pictures[0])
    tiles = find_tiles(put_together([*pictures, black, black], 2), (0.0, 0.0, 384.0, 144.0))
    assert tiles == [(0.0, 0.0, 190.0, 144.0), (194.0, 0.0, 384.0, 144.0)]


@pytest.mark.parametrize("start", [9.1, 9.3, 9.6])
def test_two_who_meet_at_a_seam_are_two(start: float) -> None:
    """One leaves the upper view downwards as the other enters the lower one from above."""
    parts = scenes(2)
    for scene, begin in zip(parts, (5.0, start), strict=True):
        scene.people[0].where = line(begin, (0.5, -0.1), (0.5, 1.6), 6.0)
    assert sorted(event.kind for event in events_of(parts, 1)) == ["entry"] * 2 + ["exit"] * 2
