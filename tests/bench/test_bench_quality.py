"""`bench quality`: its figures, its continuation of earlier runs, and its output."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

import bench.quality as quality
from bench.support.disturbances import with_wrong_clocks
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import Truth


class Small(msgspec.Struct):
    """A regime of a few cameras; counts how often it is simulated."""

    made: list[int] = msgspec.field(default_factory=list)

    def make(self, seed: int, scale: float) -> tuple[list[Event], Truth]:
        self.made.append(seed)
        settings = SimSettings(cameras=3, hours=0.15 * scale, seed=seed)
        return with_wrong_clocks(simulate(settings), settings, 1.0)

    def learning(self, scale: float) -> Settings:
        return Settings()


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Small:
    regime = Small()
    monkeypatch.setattr(quality, "REGIMES", {"small": regime})
    return regime


def test_a_run_goes_on_where_it_was_left(
    small: Small, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "results.jsonl"
    asked = [
        "--seeds",
        "2",
        "--jobs",
        "1",
        "--json",
        str(path),
        "--methods",
        "batch",
        "--regimes",
        "small",
    ]

    assert quality.main(asked) == 0
    assert small.made == [0, 1]
    first = capsys.readouterr().out
    assert "== small: 2 networks" in first
    lines = path.read_bytes().splitlines(keepends=True)
    assert len(lines) == 2
    assert quality.main(asked) == 0
    assert small.made == [0, 1]
    assert capsys.readouterr().out == first
    path.write_bytes(lines[0] + lines[1][:100])  # killed while writing
    assert quality.main(asked) == 0
    assert small.made == [0, 1, 1]
    assert len(path.read_bytes().splitlines()) == 2


def test_everything_is_in_the_table(small: Small, capsys: pytest.CaptureFixture[str]) -> None:
    assert quality.main(["--seeds", "1", "--jobs", "1", "--scale", "0.5"]) == 0

    shown = capsys.readouterr().out
    for name in ("online", "live", "oracle", "log loss", "Makris", "Hawkes", "k-means"):
        assert name in shown
