"""Heads in an outline, people who enter side by side, and people who stand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from rendered_scenes import Person, Scene, line

from camtopod.arrays import Bools


def outline(*people: tuple[int, int], height: int = 60, width: int = 80) -> Bools:
    """Return the outline of people, each with the column of the head and the row of its top."""
    mask = np.zeros((height, width), np.uint8)
    for column, top in people:
        cv2.circle(mask, (column, top + 5), 5, 255, -1)
        cv2.rectangle(mask, (column - 9, top + 12), (column + 9, height - 1), 255, -1)
    rows, columns = mask.any(axis=1).nonzero()[0], mask.any(axis=0).nonzero()[0]
    cut: Bools = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] != 0
    return cut


def pair(start: float, gap: float) -> list[Person]:
    """Return two people who cross the picture side by side, ``gap`` of its width apart."""
    return [
        Person(line(start, (-0.05 - shift, 0.7), (1.05 - shift, 0.7), 8.0), seed=seed, shade=shade)
        for shift, seed, shade in ((0.0, 1, 40), (gap, 2, 220))
    ]


def test_two_who_enter_side_by_side_are_two_without_a_detector() -> None:
    events = Scene(pair(5.0, 0.085)).events(20)
    assert sorted(event.kind for event in events) == ["entry", "entry", "exit", "exit"]
    assert len({event.track for event in events}) == 2
    first, second = (event for event in events if event.kind == "entry")
    assert first.t == pytest.approx(second.t, abs=1.5)


def test_one_who_walks_alone_stays_one() -> None:
    for tall in (0.3, 0.5):
        man = Person(line(5.0, (-0.05, 0.9), (1.05, 0.9), 8.0), tall=tall)
        assert len(Scene([man]).events(18)) == 2
