"""Haze: the contrast of the objects says how faint motion may be."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from rendered_scenes import Person, Picture, Scene, line

from camtopod.vision.detect.object_contrast import CONTRAST_SHARE_MIN, ObjectContrast


def seen(contrast: ObjectContrast, difference: int, seconds: float) -> float:
    """Show objects of one difference for a while; return the share of motion that is enough."""
    picture = np.full((60, 80), difference, np.uint8)
    mask = np.zeros_like(picture)
    mask[20:50, 30:40] = 255
    for _ in range(round(7 * seconds)):
        contrast.add(picture, mask, 1 / 7)
    return contrast.share


def test_where_there_are_no_objects_the_usual_motion_is_needed() -> None:
    contrast = ObjectContrast()
    contrast.add(np.full((60, 80), 30, np.uint8), np.zeros((60, 80), np.uint8), 1 / 7)
    assert contrast.share == 1.0


def test_the_fainter_objects_are_the_less_is_enough_within_bounds() -> None:
    shares = [seen(ObjectContrast(), difference, 1.0) for difference in range(0, 256, 5)]
    assert shares[0] == CONTRAST_SHARE_MIN
    assert shares[-1] == 1.0
    assert all(a <= b for a, b in pairwise(shares))
    assert CONTRAST_SHARE_MIN < seen(ObjectContrast(), 80, 1.0) < 1.0


def test_what_the_setting_makes_up_for_is_not_made_up_for_again() -> None:
    assert seen(ObjectContrast(sensitivity=2.0), 50, 1.0) == 1.0
    assert seen(ObjectContrast(sensitivity=2.0), 30, 1.0) < 1.0
    assert seen(ObjectContrast(sensitivity=0.5), 100, 1.0) == 1.0


def test_a_clear_picture_is_noticed_at_once_and_haze_after_a_minute_of_objects() -> None:
    contrast = ObjectContrast()
    assert seen(contrast, 150, 60.0) == 1.0
    assert seen(contrast, 50, 30.0) == 1.0
    assert seen(contrast, 50, 35.0) < 1.0
    assert seen(contrast, 150, 2.0) == 1.0


@pytest.mark.parametrize("step", [0, 15])
@pytest.mark.parametrize("clearness", [0.4, 0.5])
def test_who_follows_the_first_person_in_haze_is_counted_once(clearness: float, step: int) -> None:
    """Each wears another shade, the darkest first, or all the same."""

    class Hazy(Scene):
        def picture(self, t: float) -> Picture:
            return np.asarray(super().picture(t) * clearness + 128 * (1 - clearness), np.uint8)

    ways = ((-0.05, 0.8), (1.05, 0.8)), ((1.05, 0.9), (-0.05, 0.9))
    people = [
        Person(line(6.0 + 10.0 * k, *ways[k % 2], 6.0), 0.4, 20 + step * k, seed=k)
        for k in range(6)
    ]
    events = Hazy(people, noise=0.5).events(70.0)
    assert [event.kind for event in events if event.t > 14.0] == ["entry", "exit"] * 5
