"""`camtopod grab --show` and `--explain`, with a real grabber."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest
from rendered_scenes import Person, Scene, line

from camtopod.cli.main import main
from camtopod.vision.show.decision_words import decision_line, words_of
from camtopod.vision.track import Decision
from camtopod.vision.track.decisions import Beginning, Edge, Ending, Shortfall


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A passage from left to right, and a cat."""
    people = [
        Person(line(4.0, (-0.05, 0.7), (1.05, 0.5), 6.0)),
        Person(line(4.0, (1.05, 0.9), (-0.05, 0.9), 6.0), tall=0.1),
    ]
    return Scene(people).film(tmp_path_factory.mktemp("film") / "yard.mp4", 13.0)


def test_the_events_are_the_same_and_the_lines_say_why(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "c.toml"
    config.write_text("[cameras.yard]\nmin_height = 0.16\n")
    plain, shown, video = (tmp_path / name for name in ("plain", "shown", "v.mp4"))
    grab = ["--config", str(config), "grab", "--camera", "yard", str(film), "--out"]
    assert main([*grab, str(plain)]) == 0
    said = capsys.readouterr().err
    assert "track" not in said
    assert main([*grab, str(shown), "--show", str(video), "--explain"]) == 0
    assert shown.read_bytes() == plain.read_bytes() != b""
    assert video.stat().st_size > 10_000
    assert video.stat().st_mode & 0o777 == 0o600

    lines = [each for each in capsys.readouterr().err.splitlines() if "  yard  track " in each]
    assert sum("entry by the left border at (0.0" in each for each in lines) == 1
    assert sum("exit by the right border at (0.9" in each for each in lines) == 1
    assert any("no event: lower than min_height" in each for each in lines)


@pytest.mark.parametrize(
    ("name", "why"),
    [("folder.jpg", "is a directory: name a file"), ("none/v.mp4", "No such file or directory")],
)
def test_a_bad_file_ends_it_before_any_picture_is_read(
    name: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "folder.jpg").mkdir()
    out = ["--out", str(tmp_path / "e.jsonl"), "--show", str(tmp_path / name)]
    assert main(["grab", "--camera", "yard", "/no/such/film.mp4", *out]) == 1
    err = capsys.readouterr().err
    assert f"--show: {'cannot write ' if 'none' in name else ''}{tmp_path / name}" in err
    assert why in err
    assert not (tmp_path / "e.jsonl").exists()


def test_there_are_words_for_every_reason_and_edge() -> None:
    told = set()
    for reason in (*get_args(Beginning), *get_args(Shortfall), *get_args(Ending)):
        one = Decision(reason, 7, 12.34, (0.25, 0.5), 3.0, None, 0.2, 0.5, 3)
        told.add(words_of(one))
        assert decision_line("yard", one).startswith("12.3 s  yard  track 7: ")
        assert "{" not in words_of(one)
    assert len(told) == len((*get_args(Beginning), *get_args(Shortfall), *get_args(Ending)))
    ends = {words_of(Decision("left", 7, 12.34, (0.25, 0.5), 3.0, edge)) for edge in get_args(Edge)}
    assert len(ends) == len(get_args(Edge))
    for words in ends:
        assert words.startswith("exit by ")
        assert words.endswith(" at (0.25, 0.50)")
