"""Long commands report progress to a terminal, and to nothing else."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from serving import closing_event, walkers
from synthetic_topology import synthetic_topology

from camtopod.cli.commands import ingest, simulate
from camtopod.cli.main import main
from camtopod.cli.terminal import progress
from camtopod.cli.terminal.progress import Progress
from camtopod.codec import to_json


@pytest.fixture
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "SHOW_SECONDS", 0.0)


@pytest.mark.usefixtures("_at_once")
def test_only_a_terminal_sees_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Progress() as shown:
        shown.show("%s", "half")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with Progress() as shown:
        shown.show("%s", "half")
        assert capsys.readouterr().err == "\r\x1b[Khalf\r"
    assert capsys.readouterr().err == "\r\x1b[K", "and then it is gone"


def test_it_is_said_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    now = [10.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with Progress() as shown:
        for step in range(100):
            now[0] = 10.0 + step / 100
            shown.show("x")
        assert capsys.readouterr().err.count("x") == 1


def test_of_work_that_is_waited_for_a_pipe_hears_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [10.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with Progress(piped=True) as shown:
        for second in range(12):
            now[0] = 10.0 + second
            shown.show("%d s", second)
    assert capsys.readouterr().err == "camtopod: 5 s\ncamtopod: 10 s\n"


@pytest.mark.usefixtures("_at_once")
def test_a_recording_of_which_all_events_come_at_the_end(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(ingest, "_TICK_SECONDS", 0.001)
    lines, options = tmp_path / "gt.txt", ["--camera", "a", "--fps", "10", "--size", "99x99"]
    lines.write_text("".join(f"{n},1,{n % 50},20,30,60,1\n" for n in range(15, 20_000)))
    assert main(["ingest", "mot", str(lines), *options, "--out", str(tmp_path / "e.jsonl")]) == 0
    assert re.search(r"\r\x1b\[K\d+ lines read, 0 events\r", capfd.readouterr().err)


@pytest.mark.usefixtures("_at_once")
def test_learn_and_predict(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    events = [*walkers(60), closing_event()]
    lines = tmp_path / "e.jsonl"
    lines.write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    assert main(["learn", str(lines), "--topology", str(tmp_path / "t.json")]) == 0
    said = capfdbinary.readouterr().err.decode()
    assert f"\r\x1b[K{len(events)} lines, 100 %, 0 s left\r" in said
    assert re.findall(r"step (\d) of 8", said) == list("12345678"), "and how far the fit has come"
    assert main(["predict", str(tmp_path / "t.json"), str(lines)]) == 0
    out, err = capfdbinary.readouterr()
    assert f"\r\x1b[K120 exits predicted of {len(events)} lines" in err.decode()
    assert out.count(b"\n") == 120


@pytest.mark.usefixtures("_at_once")
def test_simulate_and_report(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(simulate, "BLOCK_LINES", 100)
    assert (
        main(
            ["simulate", "--cameras", "3", "--hours", "0.1", "--events", str(tmp_path / "e.jsonl")]
        )
        == 0
    )
    written = (tmp_path / "e.jsonl").read_bytes().count(b"\n")
    assert written > 100, "more than a block"
    assert f"\r\x1b[K100 of {written} events written" in capfdbinary.readouterr().err.decode()
    (tmp_path / "t.json").write_bytes(to_json(synthetic_topology(4)))
    assert main(["report", str(tmp_path / "t.json")]) == 0
    steps = re.findall(r"(\d+) of (\d+) parts ready", capfdbinary.readouterr().err.decode())
    assert [int(ready) for ready, _ in steps] == list(range(int(steps[0][1]))), (
        "each part is counted, once"
    )
