"""The parts of the bench that measure the learner on recordings, each with a small one."""

from __future__ import annotations

import json
import math
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from bench import ablation, between, controls, zones
from bench.change import Outcome, summary
from bench.support import mechanisms
from bench.support.recordings import Passage, Recording, load, tellable
from bench.support.regimes import REGIMES
from camtopod.codec import to_json
from camtopod.learn.next_camera import fit
from camtopod.records import Event

WALKS = 240
EVERY_SECONDS = 30.0


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a recording, in which objects are of three kinds.

    One kind passes a, then b 9 to 11 s later; one enters the view of c before leaving e; one passes
    d and is not seen again.
    """
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "walks").mkdir()
    chance, events, rows = np.random.default_rng(3), list[Event](), ["track,identity"]
    for walk in range(WALKS):
        t, e, alone = (1e6 + chance.uniform(0.0, EVERY_SECONDS * WALKS) for _ in range(3))
        b = t + 4.0 + chance.uniform(9.0, 11.0)
        for camera, came, left, identity in (
            ("a", t, t + 4.0, walk),
            ("b", b, b + 6.0, walk),
            ("e", e, e + 6.0, WALKS + walk),
            ("c", e + 4.0, e + 12.0, WALKS + walk),
            ("d", alone, alone + 4.0, 2 * WALKS + walk),
        ):
            track = f"{camera}{walk}"
            events.append(Event(camera, "entry", came, track=track))
            events.append(Event(camera, "exit", left, track=track))
            rows.append(f"{track},{identity}")
    lines = b"".join(to_json(event) + b"\n" for event in events)
    (folder / "walks" / "events.jsonl").write_bytes(lines)
    (folder / "walks" / "identities.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.mark.parametrize(
    ("part", "arguments", "shown"),
    [
        (
            "change",
            ["--seeds", "1", "--hours", "0.04", "--jobs", "steady,score"],
            "mean apart: log loss",
        ),
        ("thesis", ["1"], "table 5.3"),
    ],
)
def test_it_shows_its_figures(
    part: str, arguments: list[str], shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert import_module(f"bench.{part}").main(arguments) == 0

    assert shown in capsys.readouterr().out


def test_a_real_network_is_learned_and_foretold(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--data", str(recordings), "--jobs", "1", "--json", str(tmp_path / "real.json")]

    assert import_module("bench.real").main(arguments) == 0

    said = capsys.readouterr().out
    assert "2 of 2: 1.00" in said
    assert json.loads((tmp_path / "real.json").read_text())

    # Others beside us.
    tables = said.partition("correlation miner")[2]
    [row] = [line for line in tables.splitlines() if line.startswith("walks") and "/" in line]
    ours, rule, told = (float(cell.partition("/")[0]) for cell in row.split()[2:])
    assert max(ours, told) < rule
    assert "lower than that of ours: rule 0 of 1; rule, told " in tables


def test_objects_between_cameras_are_counted(
    recordings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert between.main(["--data", str(recordings), "--jobs", "1"]) == 0

    [row] = [line.split() for line in capsys.readouterr().out.splitlines() if "walks" in line]
    moments, truth, said, ours, balance, zero, *coverage = map(float, row[1:])
    assert moments == 10
    assert 0.0 < truth == zero <= balance
    assert abs(said - truth) <= ours + 0.01
    assert all(0.0 <= share <= 1.0 for share in coverage)


def test_the_truth_between_cameras_is_who_no_camera_sees_and_one_will() -> None:
    seen = {"a": [(0, 10), (50, 60), (5000, 5010)], "b": [(0, 30), (20, 40)], "c": [(95, 99)]}
    passages = [
        [Passage(f"{name}{k}", "x", came, left) for k, (came, left) in enumerate(rows)]
        for name, rows in seen.items()
    ]
    events = [
        Event("x", kind, t)
        for each in passages
        for one in each
        for kind, t in (("entry", one.begin), ("exit", one.end))
    ]
    events.sort(key=lambda event: event.t)
    recording = Recording("r", events, {}, passages, 0.0, 5010.0, 180.0)
    moments = np.array([5.0, 10.0, 25.0, 45.0, 50.0, 100.0, 1500.0, 5005.0])

    truth = between.truly_between(recording, 0.0, moments)
    since = between.truly_between(recording, 30.0, moments)
    balance = between.exits_less_entries(recording, 40.0, moments)

    assert truth.tolist() == [0, 1, 1, 1, 0, 0, 1, 0]
    assert since.tolist() == [0, 0, 0, 0, 0, 0, 1, 0], "seen since the replay began"
    assert balance.tolist() == [0, 0, 0, 1, 0, 1, 1, 0]


def test_a_slow_site_tells_as_much_as_the_same_at_speed(recordings: Path) -> None:
    fast, slow = load(recordings / "walks"), load(recordings / "walks", 12.0)

    assert tellable(slow) == pytest.approx(tellable(fast))
    assert slow.window == pytest.approx(12.0 * fast.window)
    assert slow.reach == 12 * fast.reach
    assert slow.events[-1].t - slow.events[0].t == pytest.approx(
        12.0 * (fast.end - fast.events[0].t)
    )


def test_a_mechanism_is_left_out(recordings: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["--data", str(recordings), "--regimes", "", "--jobs", "1"]

    assert ablation.main([*given, "--mechanisms", "sparse prior"]) == 0

    assert "- sparse prior" in capsys.readouterr().out


def test_mechanisms_that_can_be_left_out_exist() -> None:
    for mechanism in (*mechanisms.MECHANISMS, *mechanisms.VISION, *mechanisms.SCALED):
        with mechanisms.without(mechanism.name):  # fails where a name does not exist
            assert (fit.FAINT_TRANSITIONS == 0.0) == (mechanism.name == "faint transitions")


def test_a_constant_is_chosen_on_the_other_kinds_of_networks() -> None:
    """Halved, it suits the walkways; doubled, the town."""
    [(constant, _), *_] = mechanisms.CONSTANTS
    losses = {
        "walkway-a": (0.0, -3.0, 0.0),
        "walkway-b": (0.0, -5.0, 0.0),
        "town": (0.0, 1.0, -2.0),
    }
    figures = {
        (name, ablation.REAL, network): np.array([loss])
        for network, row in losses.items()
        for name, loss in zip(("", f"{constant} x 0.5", f"{constant} x 2"), row, strict=True)
    }

    *_, row = ablation.chosen_on_the_others(figures)

    assert row.split() == [
        constant,
        "+0.500",
        "(0.500)",
    ]  # walkways as in town, town as on walkways


def test_false_links_of_controls_are_counted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    title, control = next(iter(controls.controls()["steady"].items()))
    monkeypatch.setattr(controls, "controls", lambda: {"steady": {title: control}})
    arguments = ["--regimes", "", "--controls", "steady", "--seeds", "1", "--jobs", "1"]

    assert ablation.main([*arguments, "--mechanisms", "changes"]) == 0

    assert "controls, steady, 1 networks" in capsys.readouterr().out


def test_what_is_never_found_takes_for_ever() -> None:
    found = [Outcome(True, 50.0, 90.0, needed, needed < math.inf) for needed in (10, 30)]
    lost = [Outcome(True, 50.0, 90.0, math.nan, False)] * 2

    everything, soon, *_ = summary("close", found + lost)

    assert "2 found, after a median of inf passages" in everything
    assert "within 20: 0.25" in soon


@pytest.mark.parametrize("name", sorted(REGIMES))
def test_a_regime_is_made(name: str) -> None:
    events, truth = REGIMES[name].make(1, 0.02)

    assert len(events) == len(truth.identity) > 0


def test_the_cost_of_zones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sklearn")
    monkeypatch.setattr(zones, "SPEED_EVENTS", 400)
    arguments = ["--speed", "--rounds", "1", "--json", str(tmp_path / "out")]

    assert zones.main(arguments) == 0

    tables = json.loads((tmp_path / "out").read_text())["tables"]
    assert all(row["cost"]["median"] > 0 for table in tables for row in table["rows"])
