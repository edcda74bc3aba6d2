"""`bench ablation`: each mechanism can be left out and is restored; the report."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from synthetic_walks import a_recording

from bench import ablation
from bench.ablation import FIGURES, MECHANISMS, REAL, SCALED, chosen_on_the_others, table, without


@pytest.mark.parametrize("mechanism", [*MECHANISMS, *SCALED], ids=lambda one: one.name)
def test_a_mechanism_is_left_out_for_a_while(mechanism: ablation.Mechanism) -> None:
    def now() -> list[object]:
        found = []
        for name in mechanism.replaced:
            module, _, path = name.partition(":")
            owner = import_module(f"camtopod.{module}")
            for part in path.split("."):
                owner = getattr(owner, part)
            found.append(owner)
        return found

    before = now()
    with without(mechanism.name, 7):
        assert all(one is not other for one, other in zip(now(), before, strict=True))
    assert now() == before


def test_without_any_the_sampler_has_another_seed() -> None:
    posterior = import_module("camtopod.learn.next_camera.fit")
    before = posterior.SAMPLING_SEED
    with without("", before + 1):
        assert before + 1 == posterior.SAMPLING_SEED
    assert before == posterior.SAMPLING_SEED


def test_a_network_is_measured_with_and_without(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a_recording(tmp_path / "walks")
    arguments = ["--data", str(tmp_path), "--regimes", "", "--sampling-seeds", "1", "--jobs", "1"]
    assert ablation.main([*arguments, "--mechanisms", "sparse prior,contexts: all"]) == 2
    assert "no mechanism contexts: all" in capsys.readouterr().err
    assert ablation.main([*arguments, "--mechanisms", "sparse prior"]) == 0
    shown = capsys.readouterr().out
    assert "real, 1 networks" in shown
    assert "- sparse prior" in shown


def test_a_mechanism_earns_its_place_by_more_than_two_standard_errors() -> None:
    means = {}
    for network, noise in (("x", -0.01), ("y", 0.0), ("z", 0.01)):
        means["", REAL, network] = np.array([0.5, 0.3, 0.1, 0.9, math.nan])
        means["dear", REAL, network] = np.array([0.6 + noise, 0.3, 0.1, 0.9, math.nan])
        means["noisy", REAL, network] = np.array([0.505 + noise, 0.3, 0.1, 0.9, math.nan])
        means["harmful", REAL, network] = np.array([0.4 + noise, 0.3, 0.1, 1.0, math.nan])
    lines = table(means, ["dear", "noisy", "harmful"])
    assert len(FIGURES) == 5
    assert lines[-3:] == [
        "  dear: log loss of real +0.100",
        "  noisy: NOTHING",
        "  harmful: NOTHING",
    ]


def test_a_constant_is_chosen_on_the_other_networks() -> None:
    """Halved, the constant is better on x and y and worse on z; doubled, worse on all."""
    means = {}
    for network, halved in (("x", 0.4), ("y", 0.45), ("z", 0.53)):
        for name, loss in (("", 0.5), ("POOLING x 0.5", halved), ("POOLING x 2", 0.6)):
            means[name, REAL, network] = np.array([loss, 0.3, 0.1, 0.9, math.nan])
    [line] = [line for line in chosen_on_the_others(means) if line.startswith("POOLING")]
    apart = np.array([0.4, 0.45, 0.53]) - 0.5
    assert line.split()[1:] == [f"{apart.mean():+.3f}", f"({apart.std(ddof=1) / math.sqrt(3):.3f})"]
