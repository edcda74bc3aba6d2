"""What commands write: whole files, or an older one as it was; pipes, devices, standard output."""

from __future__ import annotations

import contextlib
import os
import pty
import resource
import stat
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from synthetic_topology import synthetic_topology

from camtopod import codec, files, learn_topology
from camtopod.cli import exits, main
from camtopod.cli.commands import doctor
from camtopod.records import Event

COMMANDS = {
    "report": ("report", "{topology}", "--out"),
    "export": ("export", "{topology}", "--format", "json", "--out"),
    "learn": ("learn", "{events}", "--topology"),
    "updates": ("learn", "{events}", "--updates"),
    "ingest": ("--config", "none", "ingest", "jsonl", "{events}", "--out"),
    "simulate": ("simulate", "--cameras", "3", "--hours", "0.1", "--events"),
    "truth": ("simulate", "--cameras", "3", "--hours", "0.1", "--events", "-", "--truth"),
    "doctor": ("--config", "none", "doctor", "--out"),
}
ROOM = 40
"""Bytes of a file until the disk is full."""


some = pytest.mark.parametrize("command", ["report", "ingest", "truth", "doctor"], indirect=True)
"""Those of one kind each; that all write by one function is a test of the house."""


@pytest.fixture(params=COMMANDS)
def command(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Return the words of a command; the name of its output is missing."""
    monkeypatch.setattr(doctor, "_bus", lambda _: ["not looked for"])
    topology, events = tmp_path / "given.json", tmp_path / "given.jsonl"
    topology.write_bytes(codec.to_json(synthetic_topology(4)))
    seen = [Event("lobby", "exit" if k % 2 else "entry", 60.0 * k, 0.5, 0.5) for k in range(20)]
    events.write_bytes(b"".join(codec.to_json(event) + b"\n" for event in seen))
    return [word.format(topology=topology, events=events) for word in COMMANDS[request.param]]


@contextlib.contextmanager
def full_disk() -> Iterator[None]:
    """Let no file grow beyond `ROOM`."""
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))


def test_a_file_is_whole_or_as_it_was(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    good = folder / "good"
    good.write_bytes(b"good")
    good.chmod(0o604)
    link = tmp_path / "link"
    link.symlink_to(good)

    # Through a link, on a full disk.
    with full_disk():
        assert main.main([*command, str(link)]) == exits.FAILED
    assert f"cannot write {link}: File too large" in capsys.readouterr().err
    assert good.read_bytes() == b"good"
    assert [*folder.iterdir()] == [good], "nothing is left beside it"

    # The same with room.
    assert main.main([*command, str(link)]) == exits.DONE
    assert len(good.read_bytes()) > ROOM
    assert [*folder.iterdir()] == [good]
    assert link.is_symlink()
    assert stat.S_IMODE(good.stat().st_mode) == (0o600 if "doctor" in command else 0o604)


@some
def test_a_folder_that_is_missing_is_named(
    command: list[str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main.main([*command, "nowhere/out"]) == exits.FAILED
    assert "cannot write nowhere/out: there is no folder nowhere" in capsys.readouterr().err
    assert main.main([*command, "."]) == exits.FAILED
    assert "cannot write .: Is a directory" in capsys.readouterr().err


@some
def test_a_pipe_is_written_into(command: list[str], tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    assert main.main([*command, str(pipe)]) == exits.DONE
    reader.join()
    assert len(read[0]) > ROOM
    assert pipe.is_fifo()


def test_a_device_is_written_into() -> None:
    """A terminal, as no program can put a file in its place, whatever it does."""
    outer, inner = pty.openpty()
    try:
        with files.writing(os.ttyname(inner)) as file:
            file.write(b"into it")
        assert os.read(outer, 100) == b"into it"
        assert stat.S_ISCHR(os.stat(os.ttyname(inner)).st_mode)
    finally:
        os.close(outer)
        os.close(inner)


@some
def test_a_dash_and_its_other_names_are_standard_output(
    command: list[str],
    tmp_path: Path,
    capfdbinary: pytest.CaptureFixture[bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    before = {*tmp_path.iterdir()}
    sizes = []
    for name in ("-", "/proc/self/fd/1"):  # as /dev/stdout, which a program could replace
        assert main.main([*command, name]) == exits.DONE
        sys.stdout.flush()
        sizes.append(len(capfdbinary.readouterr().out))
    assert min(sizes) > ROOM
    assert {*tmp_path.iterdir()} == before


def test_a_wrong_input_leaves_an_older_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong, good = tmp_path / "wrong", tmp_path / "good"
    wrong.write_text("no event\n")
    good.write_text("good")
    for command in (
        ["ingest", "jsonl", str(wrong), "--out"],
        ["learn", str(wrong), "--topology"],
        ["export", str(wrong), "--format", "dot", "--out"],
        ["report", str(wrong), "--out"],
    ):
        assert main.main(["--config", "none", *command, str(good)]) == exits.INPUT
        assert good.read_text() == "good"
    assert {*tmp_path.iterdir()} == {wrong, good}
    assert "nothing to ingest" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [
        ["learn", "{a}", "--topology", "{a}"],
        ["learn", "{b}", "{a}", "--updates", "{link}"],
        ["learn", "{b}", "--topology", "{new}", "--updates", "{new}"],
        ["simulate", "--events", "{new}", "--identities", "{new}"],
        ["export", "{a}", "--format", "dot", "--out", "{link}"],
        ["report", "{b}", "--updates", "{a}", "--out", "{a}"],
        ["plot", "{a}", "map", "--out", "{a}"],
        ["merge", "{b}", "{a}", "--districts", "{b}", "--out", "{a}"],
        ["ingest", "jsonl", "{a}", "--out", "{a}"],
        ["grab", "--camera", "lobby", "{a}", "--out", "-", "--show", "{a}"],
    ],
)
def test_no_input_and_no_other_output_is_overwritten(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {name: tmp_path / name for name in ("a", "b", "link", "new")}
    names["a"].write_text("events")
    names["link"].symlink_to(names["a"])
    with pytest.raises(SystemExit) as end:
        main.main(["--config", "none", *(word.format(**names) for word in command)])
    assert end.value.code == exits.USAGE
    assert "would be overwritten: give each output a name" in capsys.readouterr().err
    assert names["a"].read_text() == "events"
    assert not names["new"].exists()


@pytest.mark.parametrize("command", [["predict"], ["predict", "--walks"], ["ingest", "jsonl"]])
def test_an_empty_file_is_nothing_to_use(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, topology = tmp_path / "events.jsonl", tmp_path / "topology.json"
    path.write_text("")
    topology.write_bytes(codec.to_json(learn_topology([Event("lobby", "exit", 1.0)])))
    names = [str(path), "--out", "-"] if "ingest" in command else [str(topology), str(path)]
    assert main.main(["--config", "none", *command, *names]) == exits.INPUT
    said = capsys.readouterr()
    assert f"no event lines in {path}: nothing to {command[0]}" in said.err
    assert said.out == ""
