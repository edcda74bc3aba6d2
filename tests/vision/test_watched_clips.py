"""The grabber on real video against annotations by hand (see `watched` for the tolerances)."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from bench.support.watched_clips import VTEST, match, one_by_one, watched
from camtopod.vision.grabber import Grabber


def f1(path: Path, name: str, fps: float, aspect: float) -> float:
    grabber = Grabber("cam", str(path), wall_clock=time.time)
    events = [event for event in grabber.events() if event is not None]
    return match(watched(name, fps), events, aspect).f1


@pytest.mark.skipif(
    one_by_one() is None, reason="CAMTOPOD_TEST_DATA names no folder with one-by-one/"
)
def test_people_one_at_a_time() -> None:
    path = one_by_one()
    assert path is not None
    assert f1(path, "one_by_one", 10.0, 768 / 432) >= 0.9


@pytest.mark.skipif(not VTEST.exists(), reason="no vtest.avi (Debian package opencv-doc)")
def test_several_people_in_the_open() -> None:
    assert f1(VTEST, "vtest", 10.0, 768 / 576) >= 0.9, "10: as the file's header plays it"
