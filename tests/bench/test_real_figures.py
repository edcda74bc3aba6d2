"""Figures of real recordings: the oracle of cameras without zones."""

from __future__ import annotations

from bench.support.match_figures import oracle_odds
from bench.support.real_figures import look_figures
from bench.support.recordings import Passage, Recording
from camtopod.records import Event, Prediction

CUT = 900.0


def two_cameras_without_zones() -> Recording:
    """Return a recording: who leaves a is seen at x 5 s later; who leaves b, more, at y."""
    by_identity = []
    for source, target, times in (
        ("a", "x", [*range(110, 210, 20), *range(1000, 1080, 20)]),
        ("b", "y", [*range(100, 400, 10)]),
    ):
        for t in times:
            later = Passage(f"{target}{t}", target, t + 5.0, t + 6.0)
            by_identity.append([Passage(f"{source}{t}", source, t - 1.0, t, later), later])
    passages = {passage.track: passage for pair in by_identity for passage in pair}
    return Recording("", [], passages, by_identity, CUT, 2000.0, 100.0)


def test_the_oracle_does_not_mix_the_cameras_without_zones() -> None:
    recording = two_cameras_without_zones()
    predictions = [
        Prediction(first.camera, None, first.end, first.track, 1, 1.0, [])
        for first, _ in recording.by_identity
    ]
    assert look_figures(predictions, recording) == (0.0, 1.0)

    departure, arrival = [Event("a", "exit", 1000.0, track="a1000")], [Event("x", "entry", 1005.0)]
    none, one = (
        oracle_odds(
            recording,
            departure,
            arrival,
            {track: zone.format(passage.camera) for track, passage in recording.passages.items()},
        )
        for zone in ("", "{}/1")
    )
    assert none[0, 0] == one[0, 0] > 0
