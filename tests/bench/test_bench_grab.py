"""`bench grab` at a small size, and the arithmetic of `bench.support.ratios`."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bench import grab
from bench.baselines import frigate
from bench.support import films, ratios

needs_ffmpeg = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg")


def test_everybody_has_a_turn_in_every_round_and_another_one_begins() -> None:
    turns: list[str] = []

    def contestant(name: str) -> float:
        turns.append(name)
        return float(len(turns))

    costs = ratios.take_turns({"a": lambda: contestant("a"), "b": lambda: contestant("b")}, 2)
    assert turns == ["a", "b", "b", "a", "a", "b"]
    assert costs == {"a": [4.0, 5.0], "b": [3.0, 6.0]}


def test_ratios_are_taken_within_a_round() -> None:
    """A machine that is slower in some rounds does not change the ratios."""
    costs = {"base": [1.0, 2.0, 10.0], "other": [1.5, 3.0, 15.0]}
    table = ratios.compare("title", "s", costs, "base", {"other": 1.4})
    base, other = table.rows
    assert (base.ratio.median, other.ratio.low, other.ratio.median, other.ratio.high) == (
        1.0,
        1.5,
        1.5,
        1.5,
    )
    assert other.cost.median == 3.0
    assert (base.reached, other.reached) == (None, False)
    assert ratios.compare("title", "s", costs, "base", {"other": 1.5}).rows[1].reached is True
    assert "<= 1.40 NO" in ratios.lines(table)[2]


def test_quartiles() -> None:
    assert ratios.spread([4.0, 1.0, 2.0, 3.0, 5.0]) == ratios.Spread(3.0, 2.0, 4.0)
    assert ratios.spread([4.0, 1.0]) == ratios.Spread(2.5, 1.0, 4.0)


def test_the_time_of_children_counts() -> None:
    work = "x = 0\nfor i in range(3_000_000): x += i"
    assert (
        ratios.cpu_seconds_of(lambda: subprocess.run([sys.executable, "-c", work], check=True))
        > 0.05
    )
    assert ratios.cpu_seconds_of(lambda: None) < 0.05


def test_frigates_motion_is_seen_where_it_is() -> None:
    rng = np.random.default_rng(1)
    empty = rng.integers(90, 160, (18, 32), dtype=np.uint8).repeat(20, axis=0).repeat(20, axis=1)
    motion = frigate.Motion(640, 360)
    for _ in range(100):
        motion.detect(empty)
    assert motion.detect(empty) == []
    somebody = empty.copy()
    somebody[100:220, 300:360] = 20
    ((left, top, right, bottom),) = motion.detect(somebody)
    assert (left, top, right, bottom) == pytest.approx((300, 100, 360, 220), abs=15)


@needs_ffmpeg
def test_measured_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(grab.SIZES, "720p", (480, 272))
    monkeypatch.setattr(grab, "SMALL_DETECT", (240, 136))
    out = tmp_path / "grab.json"
    films = tmp_path / "films"
    arguments = [
        "--rounds",
        "1",
        "--seconds",
        "16",
        "--sizes",
        "720p",
        "--films",
        str(films),
        "--json",
        str(out),
    ]
    assert grab.main(arguments) == 0
    content = json.loads(out.read_text())
    assert [table["title"].split(",")[0] for table in content["tables"]] == [
        "720p busy",
        "720p quiet",
    ]
    for table in content["tables"]:
        costs = {row["name"]: row["cost"]["median"] for row in table["rows"]}
        assert len(costs) == 5
        assert all(cost > 0 for cost in costs.values())
        assert costs[grab.GRABBER] > costs[grab.DECODING]
    assert sorted(path.name for path in films.iterdir()) == [
        "720p-busy-16s-crf20.mp4",
        "720p-quiet-16s-crf20.mp4",
    ]


@needs_ffmpeg
def test_who_walks_through_a_film_is_seen(tmp_path: Path) -> None:
    walker = films.Walker(0.8, 0.3, 4.0, 60.0, True, (30, 30, 30, 20, 20, 20))
    path = films.film(tmp_path / "film.mp4", (640, 360), [walker], 17.0)
    frames = 17 * films.FPS
    figures = grab.grab(grab.Film("360p", "quiet", (640, 360), path, frames)).statistics()
    assert (figures["entries"], figures["exits"]) == (1, 1)
    looked_at, moving = frigate.watch(path, 640, 360)
    assert looked_at == pytest.approx(frames / 5, abs=2)
    assert moving > 20
