"""The parts of the bench that look at pictures, on short films; ratios of costs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
from coloured_scenes import SETTINGS, ColouredScene
from onnx_models import write_model
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, line

from bench import ablation, demo, grab, grab_truth
from bench.support import clip_variants, films, mechanisms, ratios
from bench.support.truth_clips import Clip, Picture, clips_in
from camtopod.records import Event
from camtopod.vision.settings import VisionSettings

needs_ffmpeg = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the film of a walker and its true events."""
    path = tmp_path_factory.mktemp("clips")
    walker = films.Walker(0.7, 0.3, 5.0, 60.0, True, (30, 30, 30, 20, 20, 20))
    films.film(path / "walker.mp4", (320, 240), [walker], 17.0)
    events = [("entry", 5.0, 0.0), ("exit", 5.0 + films.CROSSING_SECONDS, 1.0)]
    lines = [json.dumps({"kind": kind, "t": t, "x": x, "y": 0.7}) for kind, t, x in events]
    (path / "walker.jsonl").write_text("\n".join(lines))
    return path


@needs_ffmpeg
def test_the_grabber_costs_more_than_decoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(grab.SIZES, "720p", (320, 180))
    monkeypatch.setattr(grab, "SMALL_DETECT", (160, 90))
    given = ["--rounds", "1", "--seconds", "12", "--sizes", "720p", "--films", str(tmp_path)]

    assert grab.main([*given, "--json", str(tmp_path / "out")]) == 0

    for table in json.loads((tmp_path / "out").read_text())["tables"]:
        costs = {row["name"]: row["cost"]["median"] for row in table["rows"]}
        assert costs[grab.GRABBER] > costs[grab.DECODING] > 0


@needs_ffmpeg
def test_a_folder_is_scored_and_compared(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    assert grab_truth.main([str(folder), "--json", str(figures)]) == 0

    assert grab_truth.main([str(folder), "--against", str(figures)]) == 0

    out = capsys.readouterr().out
    assert "1 clips with 2 events" in out
    assert "mean F1 +0.000" in out
    assert "no difference" in out


@needs_ffmpeg
def test_a_mechanism_of_vision_is_worth_what_is_missed_without_it(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "walker.mp4").symlink_to(folder / "walker.mp4")
    events = [json.loads(line) for line in (folder / "walker.jsonl").read_text().splitlines()]
    truth = {"walker.mp4": {"events": events, "view": "street"}}
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    blobs = mechanisms.Mechanism("blobs", {"vision.pipeline:find_blobs": lambda *arguments: []})
    monkeypatch.setattr(mechanisms, "VISION", [blobs])
    monkeypatch.setattr(ablation, "VISION", [blobs])

    assert ablation.main(["--clips", str(tmp_path), "--jobs", "1"]) == 0

    figures = capsys.readouterr().out.splitlines()
    assert figures == ["figure: blobs, F1 = 1", "figure: blobs, false events = 0"]


def score(clip: str, *found: int) -> grab_truth.Score:
    """Return the score of a clip with ten events of which so many are found in each run."""
    runs = [grab_truth.Run(n, 10 - n, 10 - n, 0.0, 0.0) for n in found]
    return grab_truth.Score(clip, "", 10.0, 10, runs)


@pytest.mark.parametrize(
    ("now", "said"),
    [((9, 9, 7), "better"), ((5, 6, 4), "worse"), ((9, 6, 5), "no difference"), ((7, 7, 5), "no")],
)
def test_a_difference_below_its_standard_error_is_none(now: tuple[int, ...], said: str) -> None:
    before = [score("a", 7, 7), score("b", 7, 7), score("c", 5, 5)]
    after = [score(name, n, n) for name, n in zip("abc", now, strict=True)]

    [line] = grab_truth.compared(after, before)

    assert line.partition("pooled")[2].partition(": ")[2].startswith(said)


def test_a_warm_detector_is_trusted_from_the_first_pictures_on(tmp_path: Path) -> None:
    """Two enter side by side at once, whom motion takes for one."""
    walks = (line(1.0, (-0.05, 0.7), (1.05, 0.7), 8.0), line(1.0, (-0.11, 0.7), (0.99, 0.7), 8.0))
    scene = ColouredScene([Person(walk, seed=k) for k, walk in enumerate(walks)])

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        for k in range(round(14 * FPS)):
            image = scene.picture(k / FPS)
            yield Picture(k / FPS, cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), image)

    truth = (
        *(Event("pair", "entry", t, 0.0, 0.7) for t in (1.4, 1.9)),
        *(Event("pair", "exit", t, 1.0, 0.7) for t in (8.6, 9.0)),
    )
    clip = Clip("pair", "", truth, WIDTH / HEIGHT, 14.0, SETTINGS, pictures)
    detector = grab_truth.detector_of(str(write_model(tmp_path / "m.onnx", "yolox")))

    cold, _ = grab_truth.scored(clip, 1, detector)
    warm, details = grab_truth.scored(clip, 1, detector, warm=True)

    assert cold.f1 < warm.f1 == 1.0, details


def test_only_a_detector_can_be_warm(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        grab_truth.main(["--warm"])
    assert "--warm needs a --model" in capsys.readouterr().err


@needs_ffmpeg
def test_some_events_count_neither_way(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "walker.mp4").symlink_to(folder / "walker.mp4")
    line = {"kind": "entry", "t": 5.0, "x": 0.0, "y": 0.7, "person": "A"}
    maybe = [{"kind": "exit", "t": 9.0, "x": 1.0, "y": 0.7}]
    truth = {"events": [line], "maybe": maybe, "skip": [[0.4, 0.4, 0.6, 0.6]], "span": [1, 12]}
    (tmp_path / "truth.json").write_text(json.dumps({"walker.mp4": truth}))
    [clip] = clips_in(tmp_path)
    true = Event("cam", "entry", 5.5, 0.05, 0.7)
    wrong = Event("cam", "exit", 9.0, 0.7, 0.5)
    seen = [
        true,
        wrong,
        Event("cam", "exit", 9.5, 0.97, 0.7),  # maybe
        Event("cam", "exit", 9.0, 0.5, 0.5),  # in an area that is skipped
        Event("cam", "exit", 12.5, 0.7, 0.5),  # after the span
    ]

    found, missed, unmatched, spurious = clip.judged(seen)

    assert [(one.track, event) for one, event in found] == [("A", true)]
    assert missed == []
    assert len(unmatched) == 4
    assert spurious == [wrong]


@needs_ffmpeg
@pytest.mark.parametrize("name", ["mirrored", "backwards", "slowed", "shaken"])
def test_the_truth_of_a_variant_fits_its_pictures(folder: Path, name: str) -> None:
    [walker] = clips_in(folder)

    variant = clip_variants.VARIANTS[name](walker)

    assert variant is not None
    score, details = grab_truth.scored(variant, 1)
    assert (score.f1, score.true_events) == (1.0, 2), details


@needs_ffmpeg
def test_a_site_is_recorded_seen_and_learned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--seeds", "1", "--plans", "0", "--minutes", "0.5", "--films", str(tmp_path)]

    assert demo.main(arguments) == 0

    assert "of 1 sites with all zones right" in capsys.readouterr().out


def test_ratios_are_taken_within_a_round() -> None:
    """A machine that is slower in some rounds does not change the ratios."""
    costs = {"base": [1.0, 2.0, 10.0], "other": [1.5, 3.0, 15.0]}

    table = ratios.compare("title", "s", costs, "base", {"other": 1.4})

    ratio = table.rows[1].ratio
    assert (ratio.low, ratio.median, ratio.high) == (1.5, 1.5, 1.5)
    assert table.rows[1].reached is False
