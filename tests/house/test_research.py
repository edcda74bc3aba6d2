"""The notebook and the page for researchers, with pandas and networkx."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from pages import blocks
from paths import DEPLOY

from camtopod import learn_topology
from camtopod.cli.main import main
from camtopod.codec import to_json
from camtopod.sim.simulation import SimSettings, simulate

NOTEBOOK = json.loads((DEPLOY / "research.ipynb").read_text())
CODE = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def test_the_notebook_is_one_without_outputs() -> None:
    assert (NOTEBOOK["nbformat"], NOTEBOOK["nbformat_minor"]) == (4, 5)
    assert {"cells", "metadata", "nbformat", "nbformat_minor"} == set(NOTEBOOK)
    assert len({cell["id"] for cell in NOTEBOOK["cells"]}) == len(NOTEBOOK["cells"])
    for cell in NOTEBOOK["cells"]:
        assert {"cell_type", "id", "metadata", "source"} <= set(cell)
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None
    for text in CODE:
        compile(text, "research.ipynb", "exec")


def test_the_notebook_runs(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    for text in CODE:
        exec(text, names)

    out = capsys.readouterr().out
    assert len(names["between"]) > 5
    assert set(names["graph"]) == {camera.id for camera in names["topology"].cameras}
    assert names["status"] == 0
    assert ", 0 false; precision 1.00" in out
    assert " -> cam" in out


def test_the_page_reads_a_topology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    [shown] = blocks((DEPLOY / "research.md").read_text(), "python")
    topology = learn_topology(simulate(SimSettings(cameras=3, hours=0.25, seed=1))[0])
    monkeypatch.chdir(tmp_path)
    Path("topology.json").write_bytes(to_json(topology))
    assert main(["export", "topology.json", "--format", "json", "--out", "network.json"]) == 0

    names: dict[str, Any] = {}
    exec(shown, names)

    assert len(names["links"]) == len(topology.links)
    assert {"from", "to", "transit.q50"} <= set(names["links"])
    assert len(names["graph"]) == 3
