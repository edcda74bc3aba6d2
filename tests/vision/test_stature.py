"""The expected height of a person by row, from the people who were seen."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from camtopod.vision.track.stature import OUTLIER_FACTOR, Stature


def stature(samples: Sequence[tuple[float, float]], objects: int = 3) -> Stature:
    """Return the stature by samples of foot row and height, of several objects in turn."""
    result = Stature()
    for k, (row, height) in enumerate(samples):
        result.add(k % objects, row, height)
    return result


NEAR_AND_FAR = [(float(row), 0.4 * row) for row in range(60, 160, 2)]


def test_people_farther_up_in_the_image_are_less_tall() -> None:
    line = stature(NEAR_AND_FAR)
    assert line.height(60.0) == pytest.approx(24.0, abs=0.5)
    assert line.height(150.0) == pytest.approx(60.0, abs=0.5)


def test_people_in_nearly_one_row_say_nothing_of_other_rows() -> None:
    line = stature([(100.0 + k % 5, 40.0 + 2 * (k % 5)) for k in range(40)])
    assert line.height(160.0) == line.height(20.0) == pytest.approx(44.0, abs=1.0)


def test_a_height_far_away_from_all_rows_is_bounded() -> None:
    line = stature(NEAR_AND_FAR)
    middle = 0.4 * 110.0
    assert line.height(0.0) == pytest.approx(middle / OUTLIER_FACTOR, rel=0.05)
    assert line.height(500.0) == pytest.approx(middle * OUTLIER_FACTOR, rel=0.05)


def test_groups_and_fragments_are_left_out() -> None:
    samples = list(NEAR_AND_FAR)
    for k in range(0, len(samples), 6):
        samples[k] = (samples[k][0], 4 * samples[k][1])
    assert stature(samples).height(100.0) == pytest.approx(40.0, abs=2.0)


def test_a_single_object_says_nothing_of_the_height_of_others() -> None:
    assert stature(NEAR_AND_FAR, objects=1).height(100.0) is None
    assert stature(NEAR_AND_FAR, objects=2).height(100.0) is not None
