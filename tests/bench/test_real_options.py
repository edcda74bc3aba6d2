"""Options of `bench real`: labels that identities draw, and what the learner is told of the site."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from bench import real
from bench.support.real_figures import PredictionFigures
from bench.support.real_options import Options, label_shares, settings_of, with_labels
from bench.support.recordings import Recording, load
from camtopod.codec import to_json
from camtopod.records import Event

IDENTITIES = 120
SHARES = {"car": 0.8, "van": 0.12}
SEEDS = 10


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording: objects pass c, then a, then b; one goes from d to a, after the cut."""
    path = tmp_path_factory.mktemp("recordings") / "line"
    path.mkdir()
    events, rows = list[Event](), ["track,identity"]
    for walk in range(IDENTITIES):
        cameras = "da" if walk == IDENTITIES - 1 else "cab"
        for k, camera in enumerate(cameras):
            track, t = f"{camera}{walk}", 1e6 + 60.0 * walk + 15.0 * k
            events.append(Event(camera, "entry", t, track=track))
            events.append(Event(camera, "exit", t + 5.0, track=track))
            rows.append(f"{track},object {walk}")
    (path / "events.jsonl").write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    (path / "identities.csv").write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def line(folder: Path) -> Recording:
    return load(folder)


def labels_of(recording: Recording) -> list[set[str | None]]:
    """Return the labels on the events of each identity."""
    labels = {str(event.track): set[str | None]() for event in recording.events}
    for event in recording.events:
        labels[str(event.track)].add(event.label)
    return [
        set.union(*(labels[one.track] for one in passages)) for passages in recording.by_identity
    ]


def test_shares_of_labels_are_read() -> None:
    assert label_shares("car:.80, Van:.12,bus:.08") == {"car": 0.8, "van": 0.12, "bus": 0.08}
    assert label_shares("person:1") == {"person": 1.0}


@pytest.mark.parametrize(
    "text", ["", "car", "car:", "car:x", ":1", "car:0", "car:-.1", "car:nan", "car:.7,van:.4"]
)
def test_other_shares_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        real.main(["--labels", text])
    assert "argument --labels" in capsys.readouterr().err


def test_a_label_that_is_named_twice_is_refused() -> None:
    with pytest.raises(SystemExit):
        real.main(["--labels", "car:.5,Car:.5"])


def test_an_identity_draws_one_label_for_all_its_events(line: Recording) -> None:
    labels = [each for seed in range(SEEDS) for each in labels_of(with_labels(line, SHARES, seed))]

    assert {len(each) for each in labels} == {1}
    counts = Counter(label for each in labels for label in each)
    assert counts.keys() == {"car", "van", None}
    for label, share in (*SHARES.items(), (None, 0.08)):
        error = (share * (1.0 - share) / len(labels)) ** 0.5
        assert counts[label] / len(labels) == pytest.approx(share, abs=3.0 * error)


def test_labels_are_drawn_by_seed(line: Recording) -> None:
    first = with_labels(line, SHARES, seed=3).events

    assert first == with_labels(line, SHARES, seed=3).events
    assert first != with_labels(line, SHARES, seed=4).events


def test_a_slow_site_draws_the_same_labels(folder: Path, line: Recording) -> None:
    slow = with_labels(load(folder, 12.0), SHARES, seed=0)

    assert labels_of(slow) == labels_of(with_labels(line, SHARES, seed=0))


def test_true_neighbours_are_declared_and_the_other_pairs_as_none(line: Recording) -> None:
    declared = settings_of(Options(neighbours=True), line).topology

    assert declared.neighbours == (("a", "b"), ("a", "c"))
    assert declared.not_neighbours == (("a", "d"), ("b", "c"), ("b", "d"), ("c", "d"))
    assert not declared.nobody_leaves


def test_nothing_is_declared_without_options(line: Recording) -> None:
    assert settings_of(Options(), line) == settings_of(Options(labels=SHARES, stretch=2.0), line)
    assert not settings_of(Options(), line).topology.neighbours


def test_a_closed_site_is_declared(line: Recording) -> None:
    closed = settings_of(Options(nobody_leaves=True), line).topology
    both = settings_of(Options(neighbours=True, nobody_leaves=True), line).topology

    assert closed.nobody_leaves
    assert not closed.neighbours
    assert both.nobody_leaves
    assert both.neighbours


def test_options_combine_and_are_shown(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = "--stretch 2 --labels car:0.8,van:0.12 --seed 3 --neighbours --nobody-leaves"
    file = tmp_path / "real.json"

    arguments = ["--data", str(folder.parent), "--jobs", "1", "--json", str(file)]
    assert real.main([*arguments, *options.split()]) == 0

    shown = capsys.readouterr().out
    assert shown.startswith(f"options: {options}\n")
    assert "ours, told" in shown
    [result] = json.loads(file.read_text())
    assert Options(**result["options"]) == Options(2.0, SHARES, 3, True, True)


@pytest.fixture(scope="module")
def plain(folder: Path) -> PredictionFigures | None:
    return real.measure(folder, beside=False).ours


@pytest.mark.parametrize(
    "options", [Options(labels=SHARES), Options(neighbours=True), Options(nobody_leaves=True)]
)
def test_each_option_is_learned_from(
    options: Options, folder: Path, plain: PredictionFigures | None
) -> None:
    ours = real.measure(folder, options, beside=False).ours

    assert ours is not None
    assert plain is not None
    assert ours.log_loss != plain.log_loss
    assert (ours.leaving < 0.1 < plain.leaving) == options.nobody_leaves
    assert ours.left == pytest.approx(1 / 3, abs=0.02)
