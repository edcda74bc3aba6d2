"""`bench zones` at a small size."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bench import zones
from bench.support import ratios, zone_speed
from camtopod.learn.zones.zone_map import cell_sums


def test_the_cost_of_zones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("sklearn")
    monkeypatch.setattr(zone_speed, "HDBSCAN_POINTS", 400)
    monkeypatch.setattr(zone_speed, "SPECTRAL_POINTS", 300)
    monkeypatch.setattr(zone_speed, "REPEATS", 1)
    monkeypatch.setattr(ratios, "plot", lambda *_: None)
    file = tmp_path / "zones.json"
    assert (
        zones.main(["--speed", "--events", "300", "2000", "--rounds", "1", "--json", str(file)])
        == 0
    )
    written = json.loads(file.read_text())
    points = ["HDBSCAN of 400 points"] * 2 + ["SpectralClustering of 300 points"] * 2
    titles = [
        zone_speed.REFRESHED,
        zone_speed.ANEW,
        zone_speed.GROUPS,
        zone_speed.EVERYWHERE,
        *points,
    ]
    assert [table["title"] for table in written["tables"]] == titles
    flat, against = written["tables"][0], written["tables"][-1]
    assert [(row["name"], row["at_most"]) for row in flat["rows"]] == [
        ("300 events", None),
        ("2,000 events", 1.5),
    ]
    assert against["rows"][-1]["at_least"] == 500
    assert all(row["cost"]["median"] > 0 for table in written["tables"] for row in table["rows"])
    assert "SpectralClustering of 300 points" in capsys.readouterr().out


def test_sums_of_any_number_of_events_are_those_of_all_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    positions = np.random.default_rng(1).random((1001, 2))
    monkeypatch.setattr(zone_speed, "BATCH", 100)
    assert (np.array(zone_speed.summed(positions)) == np.array(cell_sums(*positions.T))).all()


def test_a_ratio_to_be_beaten() -> None:
    table = ratios.compare(
        "t", "s", {"ours": [1.0, 2.0], "other": [90.0, 190.0]}, "ours", at_least={"other": 92.5}
    )
    assert (table.rows[0].reached, table.rows[1].reached) == (None, True)
    assert ">= 92.5 yes" in ratios.lines(table)[-1]
    table = ratios.compare(
        "t", "s", {"ours": [1.0], "other": [90.0]}, "ours", at_least={"other": 91.0}
    )
    assert table.rows[1].reached is False
