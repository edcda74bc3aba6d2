"""Drawn clips with ground truth."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from bench.scenes.drawn_clips import RATE, SCENES, SECONDS, drawn_clips


@pytest.mark.parametrize("clip", drawn_clips(1), ids=list(SCENES))
def test_a_scene_has_events_of_objects_that_are_seen(clip) -> None:  # type: ignore[no-untyped-def]
    assert len(clip.truth) >= 4
    assert all(0.0 < event.t < SECONDS for event in clip.truth)

    # Something has changed in the picture between the first frame and each of the events.
    frames = {round((event.t + 0.3) * RATE) for event in clip.truth[:3] if event.kind == "entry"}
    pictures = [
        p.luma
        for p in itertools.islice(clip.pictures(0, clip.settings), max(frames, default=1) // 2 + 1)
    ]
    for frame in frames:
        changed = np.abs(pictures[frame // 2].astype(int) - pictures[0]) > 20
        assert changed.mean() > 0.001


def test_the_same_seed_draws_the_same_pictures() -> None:
    one, two = (drawn_clips(1)[0] for _ in range(2))
    assert one.truth == two.truth
    for a, b in itertools.islice(
        zip(one.pictures(0, one.settings), two.pictures(0, two.settings), strict=True), 5
    ):
        assert np.array_equal(a.luma, b.luma)
