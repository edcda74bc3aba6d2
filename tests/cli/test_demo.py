"""`camtopod demo` as a whole, with a short recording and few checks of the map."""

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
from paths import ROOT
from serving import small_config, wait_for

from camtopod.cli.commands import demo
from camtopod.cli.main import main
from camtopod.records import DaemonStatus, Topology
from camtopod.serve.bus import session as buses
from camtopod.sim.scoring import score
from camtopod.sim.truth import TRUTH_SCHEMA, Truth

UNEVEN = """
import sys
from camtopod.cli import main
from camtopod.cli.commands import demo
demo.LATENESS_SECONDS = 100.0
sys.executable = sys.argv.pop(1)
main.console()
"""
"""The demo with another interpreter for its grabbers; a third of the five minutes apart is late."""


def test_demo_works_in_an_empty_directory_though_one_grabber_is_slow(tmp_path: Path) -> None:
    slow, empty = tmp_path / "python", tmp_path / "empty"
    slow.write_text(
        f'#!/bin/sh\ncase " $* " in *" hall "*) sleep 4 ;; esac\nexec "{sys.executable}" "$@"\n'
    )
    slow.chmod(0o755)
    empty.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(empty)}
    command = [sys.executable, "-c", UNEVEN, str(slow), "demo", "--minutes", "5", "--out", "here"]
    done = subprocess.run(
        command, cwd=empty, env=environment, capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr
    assert [path.name for path in empty.iterdir()] == ["here"], "nothing is left over"
    topology = msgspec.json.decode((empty / "here" / "topology.json").read_bytes(), type=Topology)
    truth = msgspec.json.decode((empty / "here" / "truth.json").read_bytes(), type=Truth)
    result = score(topology, truth)
    assert result.text() in done.stdout
    assert result.zones_matched >= 12
    assert result.pair_recall >= 0.5  # a few minutes tell of few ways
    assert topology.as_of < time.time()
    assert topology.events > 100
    assert re.search(r"^camtopod: 5 cameras, \d+ events", done.stderr, re.M)
    assert "\r" not in done.stderr
    assert "too late" not in done.stderr
    picture = cv2.imread(str(empty / "here" / "map.png"))
    assert picture is not None
    assert picture.shape[1] > 1200


def test_the_demo_ends_when_all_is_learned_and_published_however_long_that_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Slow:
        """A daemon on a slow machine: each of its states lasts for five polls."""

        steps = ({"waiting": 1}, {"held": 9}, {"learner": 2}, {"stored": 10}, {"stored": 10})
        looks = 0

        def status(self) -> DaemonStatus:
            step = self.steps[self.looks // 5]
            self.looks += 1
            return DaemonStatus(
                events={"stored": step.get("stored", 9), "waiting": step.get("waiting", 0)},
                learner={"held": step.get("held", 0), "version": step.get("learner", 1)},
                version=1,
            )

    now = iter(range(1000))
    monkeypatch.setattr(demo.time, "monotonic", lambda: float(next(now)))
    monkeypatch.setattr(demo, "QUIET_SECONDS", 3.0)
    daemon = Slow()
    learning = demo._Learning(daemon)  # type: ignore[arg-type]
    while not learning.done():
        pass
    assert 15 < daemon.looks < 20


def test_those_that_are_ahead_wait_for_the_last(tmp_path: Path) -> None:
    def state(camera: str) -> str:
        return Path(f"/proc/{grabbers[camera].pid}/stat").read_text().rsplit(")", 1)[1].split()[0]

    bus = buses.open_daemon_session(small_config(tmp_path))
    grabbers = {camera: subprocess.Popen(["sleep", "60"]) for camera in "abc"}
    pacer = demo._Pacer(bus, grabbers, 1000.0)

    def say(**reached: float) -> None:
        for camera, t in reached.items():
            bus.publish(f"status/{camera}", {"camera": camera, "last_frame_t": t}, "status")
        wait_for(
            lambda: {camera: pacer._reached[camera] for camera in reached} == reached,
            "the statuses",
        )
        assert not pacer.done()

    bus.publish("status/a", {"camera": "a"}, "status")  # not one frame yet
    bus.publish("status/daemon", {"state": "running"}, "status")
    say(a=1031.0, b=1029.0)
    wait_for(
        lambda: [state(camera) for camera in "abc"] == ["T", "S", "S"],
        "a to be held, and nobody else",
    )
    say(c=1005.0)
    wait_for(lambda: [state(camera) for camera in "abc"] == ["S", "S", "S"], "a to go on")
    say(a=1060.0, b=1060.0)
    wait_for(lambda: [state(camera) for camera in "abc"] == ["T", "T", "S"], "both to be held")
    grabbers["c"].kill()
    grabbers["c"].wait()
    assert not pacer.done()
    wait_for(
        lambda: [state(camera) for camera in "ab"] == ["S", "S"],
        "nobody to wait for one that has ended",
    )
    for grabber in grabbers.values():
        grabber.kill()
        grabber.wait()
    assert pacer.done()
    bus.close()


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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "python"
    grabber = 'case "$*" in *" grab "*) echo it is broken >&2; exit 3;; esac'
    broken.write_text(f'#!/bin/sh\n{grabber}\nexec "{sys.executable}" "$@"\n')
    broken.chmod(0o755)
    recording = demo.Recording(
        demo.demo_plan(), [], Truth(TRUTH_SCHEMA, [], [], [], []), 1.0, {"hall": tmp_path / "x"}
    )
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
