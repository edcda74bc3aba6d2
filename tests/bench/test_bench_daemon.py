"""The parts of the bench that measure the daemon, run for seconds: shape of their output."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from serving import wait_for

from bench import ingest, latency, memory, router
from bench.support import ratios
from bench.support.site import peak_memory, resident, traffic

SMALL = ["--cameras", "4", "--learned", "400", "--rounds", "1"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Lay out a site that has learned, once."""
    return [*SMALL, "--site", str(tmp_path_factory.mktemp("site"))]


@pytest.fixture(autouse=True)
def cold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measure without a warm-up round."""
    monkeypatch.setattr(ratios, "WARM_ROUNDS", 0)


def test_the_same_network_at_every_rate() -> None:
    slow, quick = traffic(4, 0.4, 300), traffic(4, 40.0, 300)
    assert len(slow) == len(quick) == 300
    assert slow[0].t == quick[0].t == 0.0
    assert slow[-1].t > 20 * quick[-1].t
    assert {event.camera for event in quick} == {event.camera for event in slow}


def test_ingest(site: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ingest.main([*site, "--events", "1500", "--json", str(tmp_path / "out.json")]) == 0
    [table] = json.loads((tmp_path / "out.json").read_text())["tables"]
    assert [row["name"] for row in table["rows"]] == [ingest.BARE, ingest.QUIET, ingest.FITTING]
    assert table["rows"][0]["ratio"]["median"] == 1.0
    assert "events/s" in capsys.readouterr().out


def test_latency(site: list[str], tmp_path: Path) -> None:
    given = [*site, "--rate", "100", "--seconds", "1", "--json", str(tmp_path / "out.json")]
    assert latency.main(given) == 0
    median, tail, fitting = json.loads((tmp_path / "out.json").read_text())["tables"]
    for one, other in zip(median["rows"], tail["rows"], strict=True):
        assert 0.0 < one["cost"]["median"] <= other["cost"]["median"]
    assert fitting["baseline"] == latency.QUIET


BIG = 200_000_000
GROWS = f"""
import subprocess, sys
other = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
input()
big = b"1" * {BIG}
print("has it", flush=True)
input()
del big
print("has it no more", flush=True)
input()
other.communicate()
"""


def test_the_most_at_one_moment_counts_files_once() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", GROWS], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        with peak_memory(process.pid) as most:
            for answer in (b"has it\n", b"has it no more\n"):
                process.stdin.write(b"\n")
                process.stdin.flush()
                assert process.stdout.readline() == answer
                left = resident(process.pid)
                wait_for(
                    lambda left=left: most[0] >= left, "the look at it"
                )  # not one at what was growing yet
        process.stdin.write(b"\n")
        process.stdin.close()
    assert left < BIG < most[0] < BIG + left, "two interpreters, most of which is in one file"


def test_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        memory.main(["--cameras", "4", "--events", "600", "--json", str(tmp_path / "out.json")])
        == 0
    )
    [row] = json.loads((tmp_path / "out.json").read_text())["tables"][0]["rows"]
    assert 10.0 < row["cost"]["low"] <= row["cost"]["high"]
    assert " 600 " in capsys.readouterr().out


def test_router(tmp_path: Path) -> None:
    given = ["--cameras", "4", "--events", "1500", "--readers", "1,2", "--rounds", "1"]
    assert router.main([*given, "--json", str(tmp_path / "out.json")]) == 0
    [table] = json.loads((tmp_path / "out.json").read_text())["tables"]
    assert [row["name"] for row in table["rows"]] == ["1 reader", "2 readers"]
    assert all(row["cost"]["median"] > 0.0 for row in table["rows"])
