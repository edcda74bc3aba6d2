"""`bench grab_truth` on rendered clips, and what a variant makes of pictures and truth."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench import grab_truth
from bench.grab_truth import Run, Score, pooled_f1, scored, summary
from bench.support import clip_variants, films
from bench.support.clip_variants import side_by_side
from bench.support.truth_clips import Clip, TruthError, clip_of, clips_in

SIZE = (320, 240)
FPS = 14.0
SECONDS = 18.0
BEGINS, LASTS = 5.0, films.CROSSING_SECONDS
"""Time of the entry, and of the passage, seconds."""
ROW = 0.7
"""Foot row of the walker, fraction of the height."""


def film(path: Path, walker: bool = True) -> Path:
    """Render somebody who crosses the picture from the left to the right."""
    somebody = films.Walker(ROW, 0.3, BEGINS, 60.0, True, (30, 30, 30, 20, 20, 20))
    empty = films.floor(*SIZE, seed=2)
    rng = np.random.default_rng(2)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), FPS, SIZE)
    for number in range(round(SECONDS * FPS)):
        picture = empty.copy()
        if walker:
            films.draw(picture, somebody, number / FPS)
        noise = rng.normal(0, films.NOISE_SD, picture.shape).round().astype(np.int8)
        writer.write(cv2.add(picture, noise, dtype=cv2.CV_8U))
    writer.release()
    return path


def write_truth(path: Path) -> Path:
    """Write what `film` shows as lines; return the path of the clip."""
    events = [("entry", BEGINS, 0.0), ("exit", BEGINS + LASTS, 1.0)]
    lines = [json.dumps({"kind": kind, "t": t, "x": x, "y": ROW}) for kind, t, x in events]
    path.with_suffix(".jsonl").write_text("\n".join([*lines, ""]))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a clip of a walker, and a quiet one."""
    path = tmp_path_factory.mktemp("clips")
    write_truth(film(path / "walker.avi"))
    film(path / "quiet.avi", walker=False).with_suffix(".jsonl").write_text("")
    return path


@pytest.fixture(scope="module")
def walker(folder: Path) -> Clip:
    """The clip of a walker."""
    return clips_in(folder)[1]


def truth_of(clip: Clip) -> list[tuple[str, float, float, float]]:
    return [
        (e.kind, round(e.t, 2), round(e.x, 2), round(e.y, 2))
        for e in clip.truth
        if e.x is not None and e.y is not None
    ]


def test_a_folder_is_scored(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "figures.txt"
    assert grab_truth.main([str(folder), "--phases", "2", "--json", str(out)]) == 0
    quiet, busy = json.loads(out.read_text())
    assert (quiet["clip"], quiet["true_events"]) == ("quiet", 0)
    assert (busy["clip"], busy["true_events"]) == ("walker", 2)
    assert [(r["found"], r["missed"], r["spurious"]) for r in busy["runs"]] == [(2, 0, 0)] * 2
    assert busy["runs"][0]["cpu_seconds"] > 0
    said = capsys.readouterr().out
    assert "mean F1 1.000 (1.000 to 1.000), pooled 1.000, 1 clips with 2 events" in said
    assert "0.00 false events in 18 s without events" in said


def test_phases_see_other_pictures(walker: Clip) -> None:
    assert [walker.frames_skipped(phase, 2) for phase in range(2)] == [0, 1]
    first, second = (
        [picture.t for picture in walker.pictures(skipped, walker.settings)] for skipped in (0, 1)
    )
    assert np.diff(first) == pytest.approx(1 / 7, abs=0.01)
    assert second[0] - first[0] == pytest.approx(1 / 14, abs=0.01)


@pytest.mark.parametrize(
    "name", ["mirrored", "backwards", "cropped", "darkened", "slowed", "with leaves"]
)
def test_the_truth_of_a_variant_fits_its_pictures(walker: Clip, name: str) -> None:
    made = clip_variants.VARIANTS[name](walker)
    assert made is not None
    assert made.variant == name
    score, details = scored(made, 1)
    assert (score.f1, score.true_events) == (1.0, 2), details


def test_truth_of_variants(walker: Clip) -> None:
    assert truth_of(clip_variants.mirrored(walker))[0] == ("entry", 5.0, 1.0, 0.7)
    # The last frame is at 18 - 1/14 s.
    assert truth_of(clip_variants.backwards(walker)) == [
        ("entry", 3.93, 1.0, 0.7),
        ("exit", 12.93, 0.0, 0.7),
    ]
    assert truth_of(clip_variants.slowed(walker))[1] == ("exit", 21.0, 1.0, 0.7)
    cropped = clip_variants.cropped(walker)
    assert cropped is not None
    # 0.2 is cut off at the top, 0.05 at the bottom, nothing at the sides.
    assert truth_of(cropped)[0] == ("entry", 5.0, 0.0, 0.67)
    assert cropped.aspect == pytest.approx(4 / 3 / 0.75)
    (picture, *_) = cropped.pictures(0, cropped.settings)
    assert picture.luma.shape == (180, 320)


def test_nothing_is_cropped_where_people_come_and_go(folder: Path, tmp_path: Path) -> None:
    lines = [
        {"kind": "entry", "t": 1.0, "x": 0.0, "y": 0.2},
        {"kind": "exit", "t": 5.0, "x": 1.0, "y": 1.0},
    ]
    truth = tmp_path / "all.jsonl"
    truth.write_text("\n".join(map(json.dumps, lines)))
    assert clip_variants.cropped(clip_of(folder / "walker.avi", truth)) is None


def test_a_clip_that_begins_later_lacks_what_was_before(walker: Clip) -> None:
    later = clip_variants.begun_later(walker)
    assert later is not None
    assert truth_of(later) == [("exit", 8.02, 1.0, 0.7)]
    first = next(iter(later.pictures(0, later.settings)))
    assert 0.0 <= first.t < 1 / 7
    assert clip_variants.begun_later(later) is None, "hardly anything would be left"


def test_leaves_are_where_nobody_enters_or_leaves(walker: Clip) -> None:
    made = clip_variants.with_leaves(walker)
    some = zip(walker.pictures(0, walker.settings), made.pictures(0, made.settings), strict=True)
    differs = np.mean([old.luma != new.luma for old, new in some], axis=0)
    high, wide = differs.shape
    assert differs[: high // 3, : wide // 3].mean() > 0.5
    assert not differs[high // 2 :].any()
    assert not differs[:, wide // 2 :].any()


def test_a_shaken_clip_is_shifted_and_stays_in_its_picture(walker: Clip) -> None:
    shaken = clip_variants.shaken(walker)
    assert truth_of(shaken) == truth_of(walker)
    one, two, *_ = shaken.pictures(0, shaken.settings)
    assert one.luma.shape == two.luma.shape == (232, 312)
    assert np.abs(one.luma.astype(int) - two.luma).mean() > 2.0, "more than the noise"


def test_side_by_side(folder: Path) -> None:
    quiet, walker = clips_in(folder)
    both = side_by_side(walker, quiet)
    assert both.settings.working_width == 640
    assert both.seam == pytest.approx(0.5)
    assert truth_of(both)[1] == ("exit", 14.0, 0.5, 0.7)
    assert [both.scored(event) for event in both.truth] == [True, False]
    score, details = scored(both, 1)
    assert (score.f1, score.true_events) == (1.0, 1), details
    (picture, *_) = both.pictures(0, both.settings)
    assert picture.luma.shape == (240, 640)


def test_passages_by_frame_number(folder: Path, tmp_path: Path) -> None:
    """The rate of the truth is the one at which the clip is played."""
    truth = tmp_path / "walker.json"
    at = {"frame": 84, "x": 0.0, "y": 0.7}
    truth.write_text(json.dumps({"frames_per_second": 7, "passages": [{"entry": at}]}))
    clip = clip_of(folder / "walker.avi", truth)
    assert truth_of(clip) == [("entry", 12.0, 0.0, 0.7)]
    assert clip.seconds == pytest.approx(36.0)
    times = [picture.t for picture in clip.pictures(0, clip.settings)]
    assert np.diff(times) == pytest.approx(1 / 7)


def test_mistakes_have_a_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = tmp_path / "walker.jsonl"
    truth.write_text('{"kind": "entry", "t": 1, "x": 0, "y": 0}\n\n{"kind": "gone"}\n')
    with pytest.raises(TruthError, match=r"walker\.jsonl:3: "):
        clip_of(folder / "walker.avi", truth)
    assert grab_truth.main([str(tmp_path)]) == 1
    assert "no clip with a truth file" in capsys.readouterr().err
    assert grab_truth.main([str(tmp_path / "none")]) == 1


def test_means_and_pooled() -> None:
    one = Score("a", "", 10.0, 4, [Run(4, 0, 0, 1.0), Run(2, 2, 0, 1.0)])
    two = Score("b", "", 10.0, 1, [Run(0, 1, 2, 1.0), Run(1, 0, 0, 1.0)])
    quiet = Score("c", "", 30.0, 0, [Run(0, 0, 1, 0.0), Run(0, 0, 0, 0.0)])
    assert one.f1 == pytest.approx((1 + 2 / 3) / 2)
    assert two.f1 == 0.5
    assert pooled_f1([one, two]) == pytest.approx(14 / (14 + 5))
    assert (one.runs[1].precision, one.runs[1].recall) == (1.0, 0.5)
    (line,) = summary([one, two, quiet])
    assert line == (
        "the clips: mean F1 0.667 (0.500 to 0.833), pooled 0.737, 2 clips with 5 events; "
        "0.50 false events in 30 s without events; 0.067 CPU s/s"
    )
