"""What is left of other versions: their state is refused with a sentence, their topology is read."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from camtopod import codec
from camtopod.cli.main import main
from camtopod.records import Topology
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage import Journal, StateError
from camtopod.serve.storage.sqlite_file import crc

TOPOLOGY_0_2 = """{
"schema": "camtopod/topology/1", "site": "site", "epoch": "01HF8N77G00JMHN40ESJ4A702G",
"version": 4, "as_of": 1700000640.0, "events": 130, "digest": "sha256:50cb",
"cameras": [{"id": "a", "zones": ["a/1", "a/2"]}],
"zones": [
 {"id": "a/1", "camera": "a", "entries": 33, "exits": 0, "x": 0.11, "y": 0.5,
  "cov": [[2.6e-05, 0.0], [0.0, 0.0]]},
 {"id": "a/2", "camera": "a", "entries": 0, "exits": 33, "x": 0.91, "y": 0.5}],
"links": [
 {"from": "a/1", "to": "a/2", "relation": "visible", "probability": 1.0, "transitions": 33.0,
  "transit": {"mode": 4.4, "mean": 4.6, "sd": 0.9, "q10": 3.4, "q50": 4.7, "q90": 5.8,
              "mean_sd": 0.17, "q50_sd": 0.25},
  "q_value": 6.4e-184, "mahalanobis_variance": 0.00085, "histogram": {"first": 6, "mass": [1.0, 3.0, 7.0, 6.0, 7.0, 9.0]}}],
"pairs": []}"""


@pytest.mark.parametrize("written", ["1", "99"])
def test_state_of_another_format_is_refused_and_left_alone(written: str, tmp_path: Path) -> None:
    Journal(tmp_path).close()
    Spool(tmp_path / "spool.db", "b", 10).close()
    for name in ("journal.db", "spool.db"):
        with closing(sqlite3.connect(tmp_path / name)) as database, database:
            row = ("format", written)
            database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?, ?)", (*row, crc(*row)))

    with pytest.raises(StateError, match=f"has format {written} .* move the state directory away"):
        Journal(tmp_path)
    with pytest.raises(StateError, match=f"has format {written} .* move the state directory away"):
        Spool(tmp_path / "spool.db", "b", 10)
    assert not list(tmp_path.glob("*.damaged-*"))


def test_a_topology_file_of_0_2_is_read(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "topology.json"
    file.write_text(TOPOLOGY_0_2)

    assert main(["export", str(file), "--format", "dot"]) == 0

    assert codec.read(Topology, file.read_bytes()).links[0].to == "a/2"
    assert capfd.readouterr().out.startswith("digraph")
