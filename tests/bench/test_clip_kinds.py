"""Constants of the grabber are chosen on kinds of clips, and scored on the kind that was left out."""

from __future__ import annotations

import pytest

from bench.support.clip_kinds import by_kind, choice_of, leave_out_kinds
from camtopod.vision.track import assignment, tracker


def test_a_kind_is_scored_with_what_is_best_on_the_others() -> None:
    f1 = {
        0.3: {"street": 0.9, "hall": 0.5, "road": 0.6},
        0.5: {"street": 0.2, "hall": 0.6, "road": 0.7},
    }
    street, hall, road, mean, gain = leave_out_kinds(f1, 0.3)
    assert "best on the others 0.5, here 0.200" in street
    assert "best on the others 0.3, here 0.500" in hall
    assert "best on the others 0.3, here 0.600" in road
    assert mean == "chosen on the others: mean over 3 kinds 0.433, standard error 0.120"
    assert gain == "better than 0.3 by: mean over 3 kinds -0.233, standard error 0.233"


def test_the_mean_is_over_kinds_not_over_clips() -> None:
    line = by_kind({"street": [0.9, 0.7], "hall": [0.2]})
    assert (
        line == "by kind: street 0.800, hall 0.200; mean over 2 kinds 0.500, standard error 0.300"
    )


def test_a_constant_is_set_where_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (assignment, tracker):
        monkeypatch.setattr(module, "GATE_HEIGHTS", assignment.GATE_HEIGHTS)
    choice = choice_of("track.assignment:GATE_HEIGHTS=0.3,0.7")
    choice.set(choice.values[1])
    assert assignment.GATE_HEIGHTS == tracker.GATE_HEIGHTS == choice.present == 0.7
    with pytest.raises(ValueError, match="no number NOTHING"):
        choice_of("detect.blobs:NOTHING=1")
