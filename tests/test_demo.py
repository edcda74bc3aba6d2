"""`camtopod demo` whole: processes, videos, bus, daemon, learner, picture; a short recording, a rough map."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import cv2
import msgspec
import pytest

from camtopod.cli import demo
from camtopod.cli.main import main
from camtopod.records import Topology
from camtopod.sim.score import score
from camtopod.sim.truth import TRUTH_SCHEMA, Truth


def test_demo_works_in_an_empty_directory(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent), "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-m", "camtopod", "demo", "--minutes", "3", "--out", "here"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["here"], "nothing is left over"
    topology = msgspec.json.decode((tmp_path / "here" / "topology.json").read_bytes(), type=Topology)
    truth = msgspec.json.decode((tmp_path / "here" / "truth.json").read_bytes(), type=Truth)
    result = score(topology, truth)
    assert result.text() in done.stdout
    assert result.zones_matched >= 12
    assert result.pair_recall >= 0.3  # three minutes tell of few ways
    assert topology.as_of < time.time()
    assert topology.events > 100
    assert re.search(r"^entrance - hall +overlapped +-\d", done.stdout, re.M)
    assert re.search(r"^5 cameras, \d+ events", done.stderr, re.M)
    assert "\r" not in done.stderr
    picture = cv2.imread(str(tmp_path / "here" / "map.png"))
    assert picture is not None
    assert picture.shape[1] > 1200


def test_a_terminated_demo_leaves_nothing_behind(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent), "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-m", "camtopod", "demo", "--minutes", "1"]
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        lines = iter(running.stderr.readline, "")
        assert any("watching" in line for line in lines)
        running.terminate()
        rest = running.stderr.read()
    assert running.returncode == 1
    assert "interrupted" in rest
    assert [path.name for path in tmp_path.iterdir()] == ["camtopod-demo"]
    assert not list((tmp_path / "camtopod-demo").iterdir())


def test_a_grabber_that_fails_ends_the_demo_with_its_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho it is broken >&2\nexit 3\n")
    broken.chmod(0o755)
    recording = demo.Recording(demo.site(), [], Truth(TRUTH_SCHEMA, [], [], [], []), 1.0, {"hall": tmp_path / "x"})
    monkeypatch.setattr(demo, "_record", lambda *_: recording)
    monkeypatch.setattr(demo.sys, "executable", str(broken))
    assert main(["demo", "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert "grabber of hall ended with status 3" in said
    assert "it is broken" in said


def test_out_that_is_a_file_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("")
    assert main(["demo", "--out", str(tmp_path / "out")]) == 1
    assert "cannot write" in capsys.readouterr().err
    assert main(["demo", "--minutes", "0", "--out", str(tmp_path / "new")]) == 2


def test_the_demos_clock_runs_fast_and_can_skip() -> None:
    clock = demo.DemoClock(1000.0, 1e6)
    before = clock()
    deadline = time.monotonic() + 5
    while clock() == before and time.monotonic() < deadline:
        pass
    assert clock() > before >= 1000
    slow = demo.DemoClock(1000.0, 1e-9)
    slow.skip(50.0)
    assert slow() == pytest.approx(1050.0, abs=1e-3)
