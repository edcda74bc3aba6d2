"""The parts of the bench that look at pictures, on short films; ratios of costs."""

from __future__ import annotations

import itertools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from bench import demo, grab, grab_truth
from bench.scenes.drawn_clips import SCENES, drawn_clips
from bench.support import clip_variants, films, ratios
from bench.support.truth_clips import clips_in

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
def test_a_folder_is_scored(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert grab_truth.main([str(folder), "--phases", "1"]) == 0

    assert "1 clips with 2 events" in capsys.readouterr().out


@needs_ffmpeg
@pytest.mark.parametrize("name", ["mirrored", "backwards", "slowed", "shaken"])
def test_the_truth_of_a_variant_fits_its_pictures(folder: Path, name: str) -> None:
    [walker] = clips_in(folder)

    variant = clip_variants.VARIANTS[name](walker)

    assert variant is not None
    score, details = grab_truth.scored(variant, 1)
    assert (score.f1, score.true_events) == (1.0, 2), details


def test_objects_are_drawn_where_events_are() -> None:
    clips = drawn_clips(1)

    assert len(clips) == len(SCENES)
    assert all(len(clip.truth) >= 4 for clip in clips)
    first, *_, later = itertools.islice(clips[0].pictures(0, clips[0].settings), 60)
    assert np.abs(later.luma.astype(int) - first.luma).max() > 20


@needs_ffmpeg
def test_a_site_is_recorded_seen_and_learned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--seeds", "1", "--plans", "0", "--minutes", "1", "--films", str(tmp_path)]

    assert demo.main(arguments) == 0

    assert "of 1 sites with all zones right" in capsys.readouterr().out


def test_ratios_are_taken_within_a_round() -> None:
    """A machine that is slower in some rounds does not change the ratios."""
    costs = {"base": [1.0, 2.0, 10.0], "other": [1.5, 3.0, 15.0]}

    table = ratios.compare("title", "s", costs, "base", {"other": 1.4})

    ratio = table.rows[1].ratio
    assert (ratio.low, ratio.median, ratio.high) == (1.5, 1.5, 1.5)
    assert table.rows[1].reached is False
