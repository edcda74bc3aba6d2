"""`bench quality`: its figures, its continuation of earlier runs, and its output."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest

import bench.quality as quality
from bench.baselines.findings import Ranked
from bench.support.measure import (
    TRAIN_SHARE,
    Record,
    baselines,
    measure,
    network_figures,
    serve,
    with_camera_clocks,
)
from bench.support.regimes import REGIMES
from bench.support.table import mean_and_error, tables
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.sim.scoring import next_entries
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import CLUTTER, Truth


class Small(msgspec.Struct):
    """A regime of a few cameras; counts how often it is simulated."""

    made: list[int] = msgspec.field(default_factory=list)

    def make(self, seed: int, scale: float) -> tuple[list[Event], Truth]:
        self.made.append(seed)
        return simulate(SimSettings(cameras=3, hours=0.15 * scale, seed=seed, clock_sd=2.0))

    def learning(self, scale: float) -> Settings:
        return Settings()


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Small:
    regime = Small()
    monkeypatch.setattr(quality, "REGIMES", {"small": regime})
    monkeypatch.delenv("CAMTOPOD_TEST_DATA", raising=False)
    return regime


def test_a_run_goes_on_where_it_was_left(
    small: Small, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "results.jsonl"
    asked = ["--seeds", "2", "--jobs", "1", "--json", str(path), "--methods", "batch"]
    assert quality.main(asked) == 0
    assert small.made == [0, 1]
    first = capsys.readouterr().out
    assert "== small: 2 networks" in first
    assert "campus-auditorium: skipped" in first
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
    for name in (
        "online",
        "live",
        "zones right",
        "links, F1",
        "oracle",
        "log loss",
        "clock offsets",
        "calibration error, first guess",
        "events a second",
        "Var(d) <= 1",
        "Makris",
        "Tieu",
        "transfer entropy",
        "anonymous Markov",
        "Hawkes",
        "k-means",
        "HDBSCAN",
        "mean shift",
        "plain DaSpec",
        "most frequent next camera",
    ):
        assert name in shown


def test_an_unknown_regime_is_a_usage_error(
    small: Small, capsys: pytest.CaptureFixture[str]
) -> None:
    assert quality.main(["--regimes", "nowhere"]) == 2
    assert "no regime nowhere" in capsys.readouterr().err


def test_the_recording_is_read_with_its_identities(tmp_path: Path) -> None:
    lines = [
        '{"camera":"HC3","kind":"entry","t":0.0,"x":0.5,"y":0.5,"track":"a"}',
        '{"camera":"HC3","kind":"exit","t":4.0,"x":0.5,"y":0.5,"track":"a"}',
        '{"camera":"IP5","kind":"entry","t":9.0,"x":0.5,"y":0.5,"track":"b"}',
        '{"camera":"IP2","kind":"entry","t":6.0,"x":0.5,"y":0.5,"track":"c"}',
    ]
    (tmp_path / "events.jsonl").write_text("\n".join(lines) + "\n")
    (tmp_path / "identities.csv").write_text("track,identity\na,3\nb,3\n")
    events, truth = quality.campus(tmp_path)
    assert [event.t for event in events] == [0.0, 4.0, 6.0, 9.0]
    assert truth.identity == [3, 3, CLUTTER, 3]
    assert truth.passage == [0, 0, CLUTTER, 1]
    assert next_entries(events, truth) == [-1, 3, -1, -1]


def test_live_predictions_are_of_the_newest_version_made_by_then() -> None:
    events, _ = simulate(SimSettings(cameras=3, hours=0.25, objects_per_second=0.3))
    settings = Settings(refit_share=0.15)
    cut = int(TRAIN_SHARE * len(events))
    topology, predicted, _ = serve(events, settings)
    learner = Learner(settings)
    newest = []
    for event in events:
        newest.append(learner.topology.version if learner.topology else 0)
        learner.receive(event)
    versions = [newest[i] for i, event in enumerate(events) if i >= cut and event.kind == "exit"]
    assert [prediction.version for prediction in predicted.made] == versions
    assert len(set(versions)) > 2
    assert predicted.head.version == newest[cut]
    assert topology == learner.topology
    assert topology.as_of < events[-1].t  # nothing is learned that was not due


def test_a_regime_may_have_a_window_of_its_own() -> None:
    assert REGIMES["medium"].learning() == Settings()
    assert REGIMES["windows"].learning(0.1) == Settings(window_events=1000, window_camera_events=0)
    task = quality.Task("windows", 0, "batch", 0.02, None)
    events, truth = REGIMES["windows"].make(0, 0.02)
    narrow = quality.run(task).records[0].figures
    wide = measure("batch", "windows", 0, events, truth)[0].figures
    assert narrow["links_learned"] != wide["links_learned"]


def test_what_the_truth_does_not_know_is_not_scored() -> None:
    events, truth = simulate(SimSettings(cameras=3, hours=0.1))
    blind = msgspec.structs.replace(truth, zones=[], links=[], zone=[CLUTTER] * len(events))
    figures = measure("batch", "blind", 0, events, blind)[0].figures
    assert "f1" not in figures
    assert figures["relation_right"] is not None
    assert figures["top1"] is not None
    assert {r.method.split(":")[0] for r in baselines("blind", 0, events, blind)} == {
        "next",
        "links",
    }
    unknown = msgspec.structs.replace(blind, pairs=[])
    assert {r.method for r in baselines("blind", 0, events, unknown)} == {
        "next: most frequent next camera"
    }


def test_without_true_zones_pairs_of_cameras_are_found() -> None:
    from synthetic_events import topology_of

    events, truth = simulate(SimSettings(cameras=4, hours=0.6, overlap_share=0.0))
    blind = msgspec.structs.replace(truth, zones=[], links=[], zone=[CLUTTER] * len(events))
    topology = topology_of(truth)
    fewer = msgspec.structs.replace(topology, pairs=topology.pairs[1:])
    assert network_figures(fewer, blind, events)["pair_f1"] < 1
    figures: dict[str, float | None] = {**network_figures(topology, blind, events)}
    records = [Record("hall", 0, "batch", 1.0, figures), *baselines("hall", 0, events, blind)]
    line = next(
        line for line in tables(records, ["hall"]) if line.startswith("  hall, pairs of cameras")
    )
    assert line.split()[4:7] == ["-", "-", "1.000"]  # live and online were not asked for
    assert max(float(f1) for f1 in line.split()[7:]) > 0.8


def test_figures_of_a_perfect_topology() -> None:
    from synthetic_events import topology_of

    events, truth = simulate(SimSettings(cameras=4, hours=0.3))
    figures = network_figures(topology_of(truth), truth, events)
    assert (
        figures["zones_right"],
        figures["f1"],
        figures["relation_right"],
        figures["silent"],
    ) == (1, 1, 1, 1)
    assert figures["median_error"] == 0
    assert figures["recorded_median_error"] > 0  # so few walkers have another median than all
    assert "clock_error" not in figures


def test_transit_times_are_held_against_those_by_the_cameras_own_clocks() -> None:
    from synthetic_events import topology_of

    events, truth = simulate(SimSettings(cameras=4, hours=0.3, clock_sd=20.0))
    assert network_figures(topology_of(truth), truth, events)["median_error"] > 0.1
    assert (
        network_figures(topology_of(with_camera_clocks(truth)), truth, events)["median_error"] == 0
    )
    link = next(link for link in truth.links if link.relation == "unseen")
    offset = [truth.clock_offsets[zone.split("/")[0]] for zone in (link.from_, link.to)]
    shifted = next(
        one
        for one in with_camera_clocks(truth).links
        if (one.from_, one.to) == (link.from_, link.to)
    )
    assert shifted.transit.q50 == pytest.approx(link.transit.q50 + offset[1] - offset[0])
    assert shifted.transit.sd == link.transit.sd


def test_means_have_standard_errors() -> None:
    assert mean_and_error([1.0, 2.0, 3.0]) == f"2.000 ±{1 / math.sqrt(3):.3f}"
    assert mean_and_error([0.5, math.nan]) == "0.500"
    assert mean_and_error([]) == "-"


def test_targets_are_judged_by_their_means() -> None:
    records = [
        Record("sparse", seed, "online", 1.0, {"f1": f1}) for seed, f1 in enumerate((0.97, 0.996))
    ]
    records += [
        Record("sparse", seed, "batch", 1.0, {"f1": f1}) for seed, f1 in enumerate((0.97, 0.98))
    ]
    line = next(
        line for line in tables(records, ["sparse"]) if line.startswith("sparse: links, F1")
    )
    assert line.split()[-6:] == ["0.983", "±0.013", "yes", "0.975", "±0.005", "NO"]


def test_baselines_have_their_own_threshold_and_one_for_all() -> None:
    def record(regime: str, scores: list[float]) -> Record:
        return Record(
            regime, 0, "links: x", 1.0, ranked={"v": Ranked(1, scores, [2, 0], [0.1, -1.0])}
        )

    shown = tables([record("one", [10.0, 5.0]), record("two", [3.0, 2.0])], ["one", "two"])
    rows = [line.split() for line in shown if line.startswith("  x, v")]
    assert [row[2] for row in rows] == ["1.000", "1.000"]
    assert sorted(row[-2] for row in rows) == [
        "0.667",
        "1.000",
    ]  # 3.0 for both: one false link in the first
