"""The notebook and the page for researchers, with pandas and networkx."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from pages import blocks
from paths import DEPLOY

from camtopod import learn_topology
from camtopod.codec import to_json
from camtopod.sim.simulation import SimSettings, simulate

NOTEBOOK = json.loads((DEPLOY / "research.ipynb").read_text())
CELLS = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
CODE = ["".join(cell["source"]) for cell in CELLS]


def test_the_notebook_is_stored_with_its_outputs() -> None:
    assert (NOTEBOOK["nbformat"], NOTEBOOK["nbformat_minor"]) == (4, 5)
    assert {"cells", "metadata", "nbformat", "nbformat_minor"} == set(NOTEBOOK)
    assert len({cell["id"] for cell in NOTEBOOK["cells"]}) == len(NOTEBOOK["cells"])
    outputs = []
    for number, cell in enumerate(CELLS, 1):
        assert {"id", "metadata", "source"} <= set(cell)
        assert cell["execution_count"] == number, "run in order"
        outputs += cell["outputs"]
        assert cell["outputs"], cell["source"]
    kinds = {kind for output in outputs for kind in output.get("data", [output.get("name")])}
    assert kinds == {"text/plain", "text/html", "image/png", "stdout"}, "no warnings"


def test_the_notebook_runs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    pyplot = pytest.importorskip("matplotlib.pyplot", reason="needs matplotlib (camtopod[plot])")
    names: dict[str, Any] = {}
    for text in CODE:
        exec(text, names)

    out = capsys.readouterr().out
    assert len(names["between"]) > 5
    assert set(names["graph"]) == {camera.id for camera in names["topology"].cameras}
    assert len(pyplot.get_fignums()) == 2
    pyplot.close("all")
    assert names["score"].precision == 1.0
    assert names["score"].recall > 0.5
    assert " -> cam" in out


@pytest.mark.parametrize("cameras", [3, 8])
def test_the_page_reads_a_topology(
    cameras: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first two of eight cameras are not linked."""
    [shown] = blocks((DEPLOY / "research.md").read_text(), "python")
    topology = learn_topology(simulate(SimSettings(cameras=cameras, hours=0.25, seed=1))[0])
    monkeypatch.chdir(tmp_path)
    Path("topology.json").write_bytes(to_json(topology))

    names: dict[str, Any] = {}
    exec(shown, names)

    assert len(names["links"]) == len(topology.links)
    assert {"from", "to", "q50"} <= set(names["links"])
    assert len(names["graph"]) == len(names["chain"]) == cameras
    assert len(names["edges"]) == len(names["mass"]) + 1 > 2
