"""The parts of the bench that run a daemon, each for seconds."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import pytest
from paths import ROOT
from serving import AT_ONCE, program

from bench import ingest, soak
from bench.support import ratios, site as sites
from bench.support.site import traffic


@pytest.fixture(autouse=True)
def _no_backlogs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let daemons store from their start on."""
    monkeypatch.setattr(sites, "PROGRAM", program(AT_ONCE))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the arguments for a small site that has learned, laid out once."""
    folder = tmp_path_factory.mktemp("site")
    return ["--cameras", "4", "--learned", "400", "--rounds", "1", "--site", str(folder)]


def test_the_same_network_at_every_rate() -> None:
    slow, quick = traffic(4, 0.4, 300), traffic(4, 40.0, 300)

    assert len(slow) == len(quick) == 300
    assert slow[-1].t > 20 * quick[-1].t
    assert {event.camera for event in quick} == {event.camera for event in slow}


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("part", "arguments"),
    [
        ("ingest", ["--events", "300", "--cameras", "4", "--rounds", "1"]),
        ("latency", ["--rate", "20", "--seconds", "2"]),
        ("router", ["--events", "300", "--readers", "1", "--cameras", "4", "--rounds", "1"]),
        ("memory", ["--events", "300", "--cameras", "4"]),
        ("version", ["--base", str(ROOT), "--cameras", "4", "--hours", "0.2", "--rounds", "1"]),
        (
            "predict",
            ["--base", str(ROOT), "--events", "300", "--cameras", "4", "--answers", "walks"],
        ),
    ],
)
def test_its_tables_have_costs(
    part: str,
    arguments: list[str],
    site: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ratios, "WARM_ROUNDS", 0)
    given = [*site, *arguments] if part == "latency" else arguments

    assert import_module(f"bench.{part}").main([*given, "--json", str(tmp_path / "out")]) == 0

    tables = json.loads((tmp_path / "out").read_text())["tables"]
    assert all(row["cost"]["median"] > 0.0 for table in tables for row in table["rows"])


def test_a_recording_is_stored_beside_another_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stored(*arguments: list[float]) -> float:
        arguments[-1].append(40.0)
        return 2.0

    monkeypatch.setattr(ratios, "WARM_ROUNDS", 0)
    monkeypatch.setattr(ingest, "stored", stored)
    monkeypatch.setattr(ingest, "bare", lambda *_: 1.0)
    arguments = ["--base", str(ROOT), "--events", "300", "--cameras", "4", "--rounds", "1"]

    assert ingest.main([*arguments, "--json", str(tmp_path / "out")]) == 0

    tables = json.loads((tmp_path / "out").read_text())["tables"]
    costs = [[row["cost"]["median"] for row in table["rows"]] for table in tables]
    assert costs == [[1.0, *[2.0] * 4], *[[2.0] * 2, [40.0] * 2] * 2]


def test_scale_measures_a_daemon_and_a_fit_beside_live_events(tmp_path: Path) -> None:
    arguments = ["--cameras", "6", "--hours", "0.1", "--rate", "0.6", "--seconds", "3", "--json"]

    assert import_module("bench.scale").main([*arguments, str(tmp_path / "out")]) == 0

    [size] = json.loads((tmp_path / "out").read_text())["sizes"]
    assert size["processor_seconds"] > size["fit_seconds"] > 0.0
    assert 0.0 < size["median_ms"] <= size["tail_ms"]


def test_a_restart_is_timed(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--events", "300", "--behind", "100", "--times", "1"]

    assert import_module("bench.restart").main(arguments) == 0

    assert "ready after" in capsys.readouterr().out


def test_a_day_in_small(capfd: pytest.CaptureFixture[str]) -> None:
    assert soak.main(["--days", "1", "--cameras", "3", "--events", "60"]) == 1

    said = capfd.readouterr().out.splitlines()[-5:]
    assert all("are needed" in line or "never come near" in line for line in said), (
        "a day is too short to tell"
    )


def test_growth_is_held_against_an_early_day() -> None:
    def grown(days: list[int]) -> list[str]:
        sizes = (10**6 * size for size in days)
        kept = [soak.Day(n, size, 1, 1, n, 1.0, 1.0) for n, size in enumerate(sizes, start=1)]
        return list(soak.growth_violations(kept))

    assert grown([500, 100, 101, 99, 104, 100, 100]) == []
    assert grown([50, 100, 101, 102, 103, 104, 106]) == ["resident has grown by more than 5%"]
