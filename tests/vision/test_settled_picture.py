"""The picture of a scene without the people in it."""

from __future__ import annotations

import numpy as np
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Picture, Scene, line

from camtopod.vision.source.capture import Frame
from camtopod.vision.source.probe import (
    SETTLE_SECONDS_MAX,
    SETTLE_SECONDS_MIN,
    SettledPicture,
)

WALKERS = [
    Person(line(0.0, (0.1, 0.7), (1.05, 0.6), 7.0)),
    Person(line(3.0, (0.5, 1.25), (0.2, 0.3), 8.0), shade=220, seed=2),
    Person(line(4.0, (1.05, 0.6), (-0.05, 0.65), 6.0), shade=230, seed=3),
]


def settled(scene: Scene) -> tuple[SettledPicture, float]:
    """Return the picture, and the time (seconds) at which it was settled or given up."""
    picture, t = SettledPicture(), 0.0
    while not picture.is_settled and picture.seconds < SETTLE_SECONDS_MAX:
        shown = scene.picture(t)
        picture.add(Frame(t, shown, shown))
        t += 1 / FPS
    return picture, t


def error(picture: SettledPicture) -> float:
    """Return the largest difference to the empty scene, grey levels."""
    found = picture.picture()
    empty = Scene([], noise=0.0).picture(0.0)
    return float(np.abs(found.astype(int) - empty).max())


def test_who_walks_through_is_not_in_it() -> None:
    picture, seconds = settled(Scene(WALKERS))
    assert picture.is_settled
    assert SETTLE_SECONDS_MIN <= seconds < SETTLE_SECONDS_MAX / 2
    assert error(picture) < 10


def test_a_camera_that_changes_its_size_meanwhile_has_a_picture_all_the_same() -> None:
    picture = SettledPicture()
    for second in range(12):
        shown = np.full((HEIGHT * (1 + second // 8), WIDTH, 3), 90, np.uint8)
        picture.add(Frame(float(second), shown[:, :, 0], shown))
    assert picture.is_settled
    assert picture.seconds == 11.0
    assert picture.picture().shape == (HEIGHT, WIDTH, 3)


def test_what_never_settles_is_given_up_with_the_best_there_is() -> None:
    rng = np.random.default_rng(1)

    def leaves(picture: Picture) -> None:
        picture[:40, :40] = rng.uniform(0, 255, (40, 40))

    picture, seconds = settled(Scene(WALKERS, front=leaves))
    assert not picture.is_settled
    assert seconds >= SETTLE_SECONDS_MAX
    found = picture.picture()
    empty = Scene([], noise=0.0).picture(0.0)
    assert np.abs(found.astype(int) - empty)[:, 40:].max() < 10
