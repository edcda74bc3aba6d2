"""`bench real`: its definitions on a synthetic recording, and where it looks for data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from synthetic_walks import WALKS, a_recording

from bench import real
from bench.support.real_figures import (
    LEAVE,
    Oracle,
    calibration_error,
    hand_over_figure,
    link_figures,
    look_figures,
    oracle_odds,
    prediction_figures,
    who_figures,
)
from bench.support.recordings import Recording, load, tellable
from camtopod.learn.learner import Learner
from camtopod.predict.predictor import Predictor


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return a_recording(tmp_path_factory.mktemp("real") / "walks")


@pytest.fixture(scope="module")
def recording(folder: Path) -> Recording:
    return load(folder)


def test_what_is_true_of_a_recording(recording: Recording) -> None:
    assert recording.cameras == ["a", "b", "c", "d", "e"]
    links = recording.links()
    assert set(links) == {("a", "b"), ("e", "c")}
    assert 9.0 <= min(links["a", "b"]) < max(links["a", "b"]) <= 11.0
    assert np.allclose(links["e", "c"], -2.0)
    assert 0.6 * WALKS < len(links["a", "b"]) < 0.8 * WALKS
    seen = recording.in_view()
    assert (seen["a0"], seen["b0"], seen["e0"], seen["d0"]) == ({"b"}, set(), {"c"}, set())
    nats = tellable(recording)
    assert set(nats) == set(links)
    assert min(nats.values()) > 100.0


def test_what_is_found_and_foretold_of_it(recording: Recording) -> None:
    learner = Learner(only_last=True)
    for event in recording.events:
        if event.t < recording.cut:
            learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    links = link_figures(learner.topology, recording, tellable(recording))
    assert (links.true, links.right, links.false) == (2, 2, 0)
    assert (links.found, links.can_be_told) == ({6.0: 2, 20.0: 2}, {6.0: 2, 20.0: 2})
    assert links.relations_right == links.relations == 2
    assert links.transit_error < 0.5

    predictor, predictions = Predictor(learner.topology), []
    for event in recording.events:
        if event.kind == "exit":
            predictions.append(predictor.predict(event))
        predictor.observe(event)
    judged = prediction_figures(predictions, recording)
    assert judged is not None
    ours, told = judged
    assert ours.exits == told.exits > 100
    assert ours.top1 > 0.95 < told.top1
    assert told.log_loss < 0.2
    assert 0.0 < told.leave_loss <= told.log_loss
    assert all(told.saved[recall] > 10.0 for recall in (0.8, 0.9, 0.95))
    look, told_look = look_figures(predictions, recording)
    assert look > 0.95 < told_look
    overlapping = {track: others for track, others in recording.under_way().items() if others}
    assert overlapping["e0"] == {"c0"}
    assert hand_over_figure(predictions, recording) > 0.9
    who, told_who = who_figures(learner.topology, predictions, recording)
    assert who > 0.9 < told_who


def test_who_is_told_identities_knows_who_leaves_and_when_they_come(recording: Recording) -> None:
    events = {str(e.track) + e.kind: e for e in recording.events if e.t >= recording.cut}
    exits = [event for event in events.values() if event.kind == "exit"][:40]
    entries = [event for event in events.values() if event.kind == "entry"]
    odds = oracle_odds(recording, exits, entries, {})
    for row, event in enumerate(exits):
        best = entries[int(odds[row].argmax())]
        if str(event.track).startswith("d"):
            assert not np.isfinite(odds[row]).any(), "nobody who passes d is seen again"
        elif str(event.track).startswith("a") and odds[row].max() > 2.0:
            assert best.camera == "b"
            assert 8.0 < best.t - event.t < 12.0


def test_a_chain_that_is_told_falls_back() -> None:
    chain = Oracle(["a", "b", LEAVE])
    for _ in range(8):
        chain.learn("a/1", "a", "b", 5.0)
    chain.learn("a/2", "a", LEAVE, float("nan"))
    known, unknown, elsewhere = (
        chain.guess(*place).outcomes for place in (("a/1", "a"), ("a/3", "a"), ("b/1", "b"))
    )
    assert known["b"] > unknown["b"] > elsewhere["b"] > 1 / 3
    for shares in (known, unknown, elsewhere):
        assert sum(shares.values()) == pytest.approx(1.0)
    assert chain.guess("a/1", "a").ways[1][2] == (5.0, 5.0, 5.0)


def test_calibration_is_of_bins_of_equal_mass() -> None:
    assert calibration_error([0.5] * 20, [True, False] * 10) == 0.0
    assert calibration_error([0.9] * 20, [False] * 20) == pytest.approx(0.9)


def test_its_table(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        real.main(
            ["--data", str(folder.parent), "--jobs", "1", "--json", str(tmp_path / "real.json")]
        )
        == 0
    )
    out = capsys.readouterr().out
    assert "walks" in out
    assert "2 of 2: 1.00" in out
    assert (tmp_path / "real.json").read_text().startswith("[")


def test_without_data_it_says_so(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CAMTOPOD_REAL_DATA", raising=False)
    assert real.main([]) == 0
    assert "skipped" in capsys.readouterr().out
