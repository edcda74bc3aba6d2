"""Figures of a topology."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from synthetic_topology import synthetic_topology

from camtopod.cli.main import main
from camtopod.codec import to_json

TOPOLOGY = synthetic_topology(7)
LINK = next(link for link in TOPOLOGY.links if link.relation == "unseen" and link.histogram)


@pytest.fixture
def plot(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return the module, without a screen; close its figures."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    pyplot = pytest.importorskip("matplotlib.pyplot", reason="needs matplotlib (camtopod[plot])")
    from camtopod import plot

    yield plot
    pyplot.close("all")


def test_a_figure_has_what_the_topology_says(plot: Any) -> None:
    [steps] = plot.times(TOPOLOGY, LINK.from_, LINK.to).patches
    values, edges, _ = steps.get_data()
    seconds, mass = LINK.times()
    assert edges.tolist() == seconds
    assert sum(values * (edges[1:] - edges[:-1])) == pytest.approx(sum(mass))

    [image] = plot.matrix(TOPOLOGY).images
    cameras, probability, unlinked = TOPOLOGY.matrix()
    shares = [[*row, rest] for row, rest in zip(probability, unlinked, strict=True)]
    assert image.get_array().tolist() == shares

    axes = plot.network(TOPOLOGY)
    assert set(cameras) <= {text.get_text() for text in axes.texts}
    colours = [line.get_color() for line in axes.lines]
    overlaps = sum(pair.relation == "overlapped" for pair in TOPOLOGY.pairs)
    assert colours.count("black") == overlaps
    assert colours.count("darkgrey") == len(TOPOLOGY.pairs) - overlaps


def test_the_command_writes_figures(
    plot: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "topology.json", tmp_path / "figure.svg"
    path.write_bytes(to_json(TOPOLOGY))
    command = ["plot", str(path), "--out", str(out)]

    for figure in (["map"], ["matrix"], ["times", LINK.from_, LINK.to]):
        assert main([*command, *figure]) == 0
        assert b"<svg" in out.read_bytes()
        out.unlink()

    assert main([*command, "times", LINK.from_, "nowhere"]) == 1
    assert main([*command, "map", LINK.from_]) == 2
    assert "has no link from" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(command)
    assert "required: FIGURE\n" in capsys.readouterr().err
    assert not out.exists()


def test_without_matplotlib_the_command_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "topology.json"
    path.write_bytes(to_json(TOPOLOGY))
    monkeypatch.delitem(sys.modules, "camtopod.plot", raising=False)
    monkeypatch.delattr("camtopod.plot", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)

    assert main(["plot", str(path), "map", "--out", str(tmp_path / "map.png")]) == 1
    assert "pip install 'camtopod[plot]'" in capsys.readouterr().err
