"""`camtopod demo` as a whole, with a short recording and few checks of the map."""

from __future__ import annotations

import itertools
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

import cv2
import msgspec
import pytest
from paths import ROOT

from camtopod.cli.commands import demo
from camtopod.cli.main import main
from camtopod.records import Topology
from camtopod.sim.scoring import score
from camtopod.sim.truth import Truth

UNEVEN = """
import sys
from camtopod.cli import main
sys.executable = sys.argv.pop(1)
main.console()
"""
"""The demo with another interpreter for its grabbers."""


@pytest.mark.timeout(300)
def test_demo_works_in_an_empty_directory_though_one_grabber_is_slow(tmp_path: Path) -> None:
    slow, empty = tmp_path / "python", tmp_path / "empty"
    slow.write_text(
        f'#!/bin/sh\ncase " $* " in *" hall "*) sleep 2 ;; esac\nexec "{sys.executable}" "$@"\n'
    )
    slow.chmod(0o755)
    empty.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(empty)}
    command = [sys.executable, "-c", UNEVEN, str(slow), "demo", "--minutes", "4", "--out", "here"]
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    begin = time.monotonic()
    with subprocess.Popen([*command, "--page"], cwd=empty, env=environment, **pipes) as running:
        lines = list(itertools.takewhile(lambda line: "Ctrl-C" not in line, running.stderr))
        address = next(line.split()[-1] for line in lines if "the page is at" in line)
        for path in ("data/map", "picture/hall"):
            with urllib.request.urlopen(address + path, timeout=20) as answer:
                assert len(answer.read()) > 1000
        with urllib.request.urlopen(address + "data/health", timeout=20) as answer:
            health = msgspec.json.decode(answer.read())
        last = max(camera["newest"] for camera in health["cameras"])
        assert 0 <= health["now"] - last < time.monotonic() - begin + 30, "it has just ended"
        running.send_signal(signal.SIGINT)
        stdout, rest = running.communicate(timeout=60)
    stderr = "".join([*lines, rest])
    assert running.returncode == 0, stderr
    assert [path.name for path in empty.iterdir()] == ["here"], "nothing is left over"
    topology = msgspec.json.decode((empty / "here" / "topology.json").read_bytes(), type=Topology)
    truth = msgspec.json.decode((empty / "here" / "truth.json").read_bytes(), type=Truth)
    result = score(topology, truth)
    assert result.text() in stdout
    assert result.zones_matched >= 12
    assert result.pair_recall >= 0.5  # a few minutes tell of few ways
    assert topology.as_of < time.time()
    assert topology.events > 100
    assert re.search(r"^demo: 5 cameras, \d+ events", stderr, re.M)
    assert "\r" not in stderr
    picture = cv2.imread(str(empty / "here" / "map.png"))
    assert picture is not None
    assert picture.shape[1] > 1200


def test_a_terminated_demo_leaves_nothing_behind(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-m", "camtopod", "demo", "--minutes", "1"]
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stderr is not None
        lines = iter(running.stderr.readline, "")
        assert any("playing the videos" in line for line in lines)
        running.terminate()
        rest = running.stderr.read()
    assert running.returncode == 1
    assert "interrupted" in rest
    assert [path.name for path in tmp_path.iterdir()] == ["camtopod-demo"]
    assert not list((tmp_path / "camtopod-demo").iterdir())


def test_a_grabber_that_fails_ends_the_demo_with_its_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "python"
    grabber = 'case "$*" in *" grab "*) echo it is broken >&2; exit 3;; esac'
    broken.write_text(f'#!/bin/sh\n{grabber}\nexec "{sys.executable}" "$@"\n')
    broken.chmod(0o755)
    monkeypatch.setattr(demo, "_rendered", lambda *_: {"hall": tmp_path / "x"})
    monkeypatch.setattr(demo.sys, "executable", str(broken))
    assert main(["demo", "--minutes", "1", "--out", str(tmp_path / "out")]) == 1
    said = capfd.readouterr().err
    assert "grabber of hall ended with status 3" in said
    assert "it is broken" in said


def test_out_that_is_a_file_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("")
    assert main(["demo", "--out", str(tmp_path / "out")]) == 1
    assert "cannot write" in capsys.readouterr().err
    assert main(["demo", "--minutes", "0", "--out", str(tmp_path / "new")]) == 2
