"""The parts of the bench about the growth of the learner's cost."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench import links, scale


def test_scale_compares_each_size_with_the_one_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "scale.json"
    assert scale.main(["--cameras", "3,6", "--hours", "0.1", "--json", str(figures)]) == 0
    written = json.loads(figures.read_text())
    smaller, larger = written["sizes"]
    assert [smaller["cameras"], larger["cameras"]] == [3, 6]
    step = written["tables"][0]["rows"][1]["ratio"]["median"]
    assert step == pytest.approx(larger["each_microseconds"][0] / smaller["each_microseconds"][0])
    assert f"{step:.2f}" in capsys.readouterr().out


def test_links_counts_a_version_a_minute_for_the_others(tmp_path: Path) -> None:
    figures = tmp_path / "links.json"
    assert links.main(["--cameras", "3", "--events", "600", "--json", str(figures)]) == 0
    written = json.loads(figures.read_text())
    versions, rate = written["tables"]
    ours = next(row for row in versions["rows"] if row["name"] == links.OURS)
    assert rate["rows"][0]["cost"]["median"] == pytest.approx(
        written["events"] / ours["cost"]["median"]
    )
    least = min(row["cost"]["median"] for row in versions["rows"] if row["name"] != links.OURS)
    assert ours["ratio"]["median"] == pytest.approx(ours["cost"]["median"] / least)
