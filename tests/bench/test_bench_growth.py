"""The parts of the bench about the growth of the learner's cost."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench import links, scale


def test_scale_measures_a_daemon_and_a_fit_beside_live_events(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "scale.json"
    given = ["--cameras", "4", "--hours", "0.2", "--seconds", "20", "--json", str(figures)]

    assert scale.main(given) == 0

    [size] = json.loads(figures.read_text())["sizes"]
    assert size["cameras"] == 4
    assert size["processor_seconds"] > size["fit_seconds"] > 0.0
    assert 0.0 < size["median_ms"] <= size["tail_ms"]
    assert f"{size['processor_seconds']:.0f}" in capsys.readouterr().out


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
