"""Long commands report progress to a terminal, and to nothing else."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from serving import closing_event, walkers

from camtopod.cli.main import main
from camtopod.cli.terminal import progress
from camtopod.cli.terminal.progress import ProgressLine
from camtopod.codec import to_json


@pytest.fixture
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "SHOW_SECONDS", 0.0)


def test_of_work_that_is_waited_for_a_pipe_hears_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [10.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with ProgressLine(lines=True) as shown:
        for second in range(12):
            now[0] = 10.0 + second
            shown.show("%d s", second)
    assert capsys.readouterr().err == "camtopod: 5 s\ncamtopod: 10 s\n"


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
    assert f"\r\x1b[K{len(events)} lines, 100 %\r" in said
    assert re.findall(r"step (\d) of 8", said) == list("12345678"), "and how far the fit has come"
    assert main(["predict", str(tmp_path / "t.json"), str(lines)]) == 0
    out, err = capfdbinary.readouterr()
    assert f"\r\x1b[K120 exits predicted of {len(events)} lines" in err.decode()
    assert out.count(b"\n") == 120
