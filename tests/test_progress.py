"""Long work says how far it has come, to a terminal and to nothing else."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from serving import closing_event, walkers

from camtopod.cli import progress
from camtopod.cli.main import main
from camtopod.cli.progress import Progress
from camtopod.codec import to_json


@pytest.fixture
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "SHOW_SECONDS", 0.0)


@pytest.mark.usefixtures("_at_once")
def test_only_a_terminal_sees_it(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    with Progress() as shown:
        shown.show("%s", "half")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with Progress() as shown:
        shown.show("%s", "half")
        assert capsys.readouterr().err == "\r\x1b[Khalf\r"
    assert capsys.readouterr().err == "\r\x1b[K", "and then it is gone"


def test_it_is_said_now_and_then(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    now = [10.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with Progress() as shown:
        for step in range(100):
            now[0] = 10.0 + step / 100
            shown.show("x")
        assert capsys.readouterr().err.count("x") == 1


@pytest.mark.usefixtures("_at_once")
def test_learn_and_predict(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    events = [*walkers(60), closing_event()]
    lines = tmp_path / "e.jsonl"
    lines.write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    assert main(["learn", str(lines), "--topology", str(tmp_path / "t.json")]) == 0
    assert f"\r\x1b[K{len(events)} lines, version " in capfdbinary.readouterr().err.decode()
    assert main(["predict", str(tmp_path / "t.json"), str(lines)]) == 0
    out, err = capfdbinary.readouterr()
    assert f"\r\x1b[K120 exits predicted of {len(events)} lines" in err.decode()
    assert out.count(b"\n") == 120
