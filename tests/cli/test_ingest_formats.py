"""`camtopod ingest` of other formats: into a file, onto the bus, and lines that are refused."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import json
import lzma
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import frigate_messages as says
import pytest
from serving import T0, wait_for

from camtopod.adapt.frigate import Frigate
from camtopod.cli import exits
from camtopod.cli.main import main
from camtopod.codec import event_from_json, to_json
from camtopod.records import Event


def lines_of(path: Path) -> list[Event]:
    return [event_from_json(line) for line in path.read_bytes().splitlines()]


def document(second: int, there: bool) -> str:
    """Return a document of an ONVIF metadata stream, with somebody in view or not."""
    box = '<BoundingBox left="-0.2" top="0.6" right="0.2" bottom="-0.2"/>'
    one = f'<Object ObjectId="7"><Appearance><Shape>{box}</Shape></Appearance></Object>'
    return (
        f"<MetadataStream><VideoAnalytics>\n<Frame UtcTime="
        f'"2023-11-14T22:13:{second:02}Z">{one if there else ""}</Frame>\n'
        f"</VideoAnalytics></MetadataStream>\n"
    )


@contextlib.contextmanager
def ingesting(*arguments: str, out: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run `camtopod ingest` in a process of its own, which writes events to ``out``."""
    out.touch()
    command = [sys.executable, "-m", "camtopod", "ingest", *arguments, "--out", str(out)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


WRITERS: dict[str, Callable[[list[Any]], str]] = {
    "lines of Windows": lambda all_: "\r\n".join(map(json.dumps, all_)),
    "lines of old systems": lambda all_: "\r".join(map(json.dumps, all_)),
    "nothing between": lambda all_: "".join(map(json.dumps, all_)),
    "several lines": lambda all_: "\n".join(json.dumps(one, indent=2) for one in all_),
    "lines without indentation": lambda all_: "\n".join(json.dumps(one, indent=0) for one in all_),
    "an array": json.dumps,
    "an array over lines": lambda all_: json.dumps(all_, indent="\t"),
    "an element a line": lambda all_: "[\n" + ",\n".join(map(json.dumps, all_)) + "\n]\n",
    "a sequence (RFC 7464)": lambda all_: "".join(f"\x1e{json.dumps(one)}\n" for one in all_),
}
"""How programs write several JSON objects."""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return the output of `mosquitto_sub -v` for ten passages, with some other lines."""
    lines = [b"frigate/events " + line for n in range(10) for line in says.passage(n, T0 + 20 * n)]
    lines[4:4] = [
        b'frigate/tracked_object_update {"type": "face", "name": "Jane Doe"}',
        b"frigate/yard/person 2",
    ]
    lines[9:9] = [b'frigate/events {"type": "new", "before": {"sub_label": ["Jane Doe", 0.9]']
    path = tmp_path / "frigate.txt"
    path.write_bytes(b"\n".join(lines) + b"\n")
    return path


def test_lines_without_a_bus(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "events.jsonl"
    assert (
        main(["ingest", "frigate", str(recording), "--size", "yard=1280x720", "--out", str(out)])
        == exits.DONE
    )
    assert [event.kind for event in lines_of(out)] == ["entry", "exit"] * 10
    err = capsys.readouterr().err
    assert f"{recording}:5: is not of */events (further" in err
    assert f"{recording}:6: " not in err, "one of a kind is enough"
    assert f"{recording}:10: it is empty, or cut off" in err
    assert "3 of 33 lines were rejected: malformed 1, other-topic 2" in err
    assert "Jane" not in err + out.read_text()


def test_from_standard_input_to_standard_output(
    monkeypatch: pytest.MonkeyPatch, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    """A MOTChallenge file passes through a pipe."""
    rows = "".join(f"{n},4,{8 * n},20,30,60,1,-1,-1,-1\n" for n in range(15, 40))
    rows += "90,9,0,0,1,1,1\n"
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(rows.encode())))
    options = "--camera gate --fps 10 --size 400x200 --start 1000 --out -"

    assert main(["ingest", "mot", *options.split()]) == exits.DONE
    events = [event_from_json(line) for line in capsysbinary.readouterr().out.splitlines()]
    assert [(e.camera, e.kind, e.t, e.x, e.y, e.track) for e in events] == [
        ("gate", "entry", 1001.4, 0.3375, 0.4, "4"),
        ("gate", "exit", 1003.8, 0.8175, 0.4, "4"),
    ]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("mot x.txt", "mot needs --camera, --fps, and --size"),
        ("mot x.txt --camera a --fps 0 --size 4x4", "above 0"),
        ("mot x.txt --camera a --fps 5 --size b=4x4", "--size of that camera"),
        ("mot x.txt --rename a=b", "--rename is for frigate, scenescape, axis, onvif, deepstream"),
        ("frigate x.txt --fps 5", "--fps is for mot, not frigate"),
        ("scenescape x.txt --ca y.pem", "are for mqtt[s]:// only"),
        ("mot mqtt://h/m --camera a --fps 5 --size 4x4", "cannot be read from MQTT"),
        ("frigate mqtt://u:hunter2@h/frigate", "put it in a file"),
        ("frigate mqtt://h", "PREFIX"),
        ("frigate mqtt://h/frigate/#", "PREFIX"),
        ("frigate mqtt://h/frigate/%23", "PREFIX"),
        ("frigate mqtt://h/fri+", "PREFIX"),
    ],
)
def test_usage(line: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ingest", *line.split(), "--out", "-"]) == exits.USAGE
    err = capsys.readouterr().err
    assert said in err
    assert "hunter2" not in err


def test_a_size_is_width_and_height(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["ingest", "frigate", "x.txt", "--size", "4by4"])
    assert ended.value.code == exits.USAGE
    assert "write it like 1280x720" in capsys.readouterr().err


def test_reading_that_fails_in_the_middle_is_no_success(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: Any) -> list[Event]:
        raise RuntimeError("nobody expected this")

    monkeypatch.setattr("camtopod.adapt.frigate.Frigate.close", broken)
    with pytest.raises(RuntimeError, match="nobody expected this"):
        main(["ingest", "frigate", str(recording), "--out", str(tmp_path / "x")])


def test_whatever_a_message_does_to_an_adapter_it_alone_is_refused(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    receive = Frigate.receive

    def fragile(self: Frigate, line: bytes) -> list[Event]:
        return [] if 1 / (b"yard/person" not in line) < 1 else receive(self, line)

    monkeypatch.setattr(Frigate, "receive", fragile)
    sizes = ["--size", "yard=1280x720"]
    assert main(["ingest", "frigate", str(recording), *sizes, "--out", "-"]) == exits.DONE
    said = capsys.readouterr()
    assert said.out.count("\n") == 20
    assert f"{recording}:6: it cannot be read (ZeroDivisionError)" in said.err


def ingested(
    capsysbinary: pytest.CaptureFixture[bytes],
    path: Path,
    kind: str,
    *options: str,
    status: int = exits.DONE,
) -> tuple[list[Event], str]:
    """Return the events of a file, and what was said of it."""
    assert main(["ingest", kind, str(path), *options, "--out", "-"]) == status
    said = capsysbinary.readouterr()
    return [event_from_json(line) for line in said.out.splitlines()], said.err.decode()


@pytest.mark.parametrize("style", [*WRITERS])
def test_messages_are_found_however_they_are_written(
    style: str, tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    """Event lines, and messages of Frigate and DeepStream, which are written by many programs."""
    events = [
        {"camera": "lobby", "kind": kind, "t": T0 + n, "x": 0.5, "y": 0.5, "track": '"{'}
        for n, kind in enumerate(["entry", "exit"])
    ]
    frames = [
        {
            "@timestamp": 1000 * T0 + 250 * n,
            "sensorId": "lobby",
            "objects": ["7|900|100|1000|540|Person"] if 20 <= n < 36 else [],
            "more": {"a": [{}, {"b": []}]},
        }
        for n in range(56)
    ]
    passage = [json.loads(line) for line in says.passage(1, T0)]
    for kind, messages, options in (
        ("jsonl", events, []),
        ("deepstream", frames, ["--size", "1900x900"]),
        ("frigate", passage, ["--size", "1280x720"]),
    ):
        path = tmp_path / kind
        path.write_bytes(WRITERS[style](messages).encode())
        found, said = ingested(capsysbinary, path, kind, *options)
        assert [event.kind for event in found] == ["entry", "exit"], kind
        assert "rejected" not in said


def test_what_is_cut_off_costs_nothing_that_follows(
    tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    events = [Event("lobby", "entry", T0 + n, 0.5, 0.5, "[{") for n in range(100)]
    lines = [to_json(event) + b"\n" for event in events]
    path = tmp_path / "cut.jsonl"
    cuts = range(1, len(lines[0]) - 1)
    path.write_bytes(b"".join(lines[0][:cut] + b"\n" + lines[cut] for cut in cuts))
    found, said = ingested(capsysbinary, path, "jsonl", status=exits.FAILED)
    assert len(found) == len(cuts)
    assert f"{len(cuts)} of {2 * len(cuts)} lines were rejected" in said


def test_a_pipe_without_line_breaks_gives_its_events_while_it_is_open(tmp_path: Path) -> None:
    """ffmpeg writes the documents of a metadata stream one behind the other."""
    with ingesting("onvif", "-", "--camera", "lobby", out=tmp_path / "out") as process:
        assert process.stdin is not None
        for n in range(15):
            process.stdin.write(document(n, there=4 < n < 9).replace("\n", "").encode())
            process.stdin.flush()
        wait_for(lambda: (tmp_path / "out").read_bytes().count(b"\n") == 2, "both events")
        assert process.poll() is None


def test_xml_that_never_ends_is_refused_once(
    tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    """And the documents behind it are read."""
    path = tmp_path / "x.xml"
    text = "".join(document(n, there=4 < n < 9) for n in range(15))
    path.write_text("<a>\n" + "x\n" * 600_000 + text)
    found, said = ingested(capsysbinary, path, "onvif", "--camera", "lobby")
    assert [event.kind for event in found] == ["entry", "exit"]
    assert f"{path}:1: more than 1048576 bytes" in said
    assert "1 of 16 lines were rejected: too-long 1" in said


@pytest.mark.parametrize(
    ("form", "said"),
    [
        (gzip.compress, "gunzip -c"),
        (lzma.compress, "xz -dc"),
        (bz2.compress, "bunzip2 -c"),
    ],
)
def test_text_in_another_form_is_named(
    form: Callable[[bytes], bytes], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "events.jsonl"
    path.write_bytes(form(to_json(Event("lobby", "entry", T0))))
    assert main(["ingest", "jsonl", str(path), "--out", "-"]) == exits.INPUT
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_text_in_another_encoding_is_read(
    encoding: str, tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    path = tmp_path / "events.jsonl"
    path.write_bytes((to_json(Event("lobby", "entry", T0)).decode() + "\n").encode(encoding))
    assert len(ingested(capsysbinary, path, "jsonl")[0]) == 1


def test_byte_order_marks_are_skipped(
    tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    events, rows = tmp_path / "events.jsonl", tmp_path / "gt.txt"
    events.write_bytes(b"\xef\xbb\xbf" + to_json(Event("lobby", "entry", T0)) + b"\r\n")
    assert len(ingested(capsysbinary, events, "jsonl")[0]) == 1
    rows.write_bytes(b"\xef\xbb\xbf1,9,0,0,5,5,1\r2,4,1,1,5,5,1\r\n3,4,1,1,5,5,1\r")
    _, said = ingested(capsysbinary, rows, "mot", *["--camera", "a", "--fps", "1", "--size", "9x9"])
    assert "rejected" not in said
    assert "3 lines" in said


def test_what_an_api_of_frigate_returns_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "events.json"
    path.write_bytes(to_json([{"id": "1", "camera": "yard", "start_time": T0, "data": {}}] * 2))
    assert main(["ingest", "frigate", str(path), "--out", "-"]) == exits.INPUT
    assert "is no message of frigate/events, with type, before, after" in capsys.readouterr().err


def test_each_kind_of_mistake_is_quoted_once(
    tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    good = {"camera": "lobby", "kind": "entry", "t": T0, "x": 0.5, "y": 0.5}
    wrong: list[dict[str, Any]] = [{"x": 411}, {"camera": "Front Door"}, {"kind": "ENTRY"}]
    wrong += [{"t": 1000 * T0}, {"t": "2026-03-02"}, {"track": 17.5}]
    path = tmp_path / "events.jsonl"
    path.write_bytes(b"".join(to_json(good | one) + b"\n" for one in [*wrong, {}, *wrong]))
    found, said = ingested(capsysbinary, path, "jsonl", status=exits.FAILED)
    assert len(found) == 1
    quoted = [line for line in said.splitlines() if "events.jsonl:" in line]
    for place in ["x", "camera", "kind", "t", "track"]:
        assert sum(f"at `$.{place}`" in line for line in quoted) == 1, place
    assert len(quoted) == 5
    assert "(milliseconds, or text?)" in said


def test_cameras_that_send_xml_or_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """ONVIF and DeepStream from a file; a line that does not fit is counted."""
    xml = "".join(document(n, there=4 < n < 9) for n in range(15))
    frames = "".join(
        f'{{"@timestamp": {1000 * T0 + 250 * n}, "sensorId": "lobby", "objects": '
        f"{['7|900|100|1000|540|Person'] if 20 <= n < 36 else []}}}\n".replace("'", '"')
        for n in range(56)
    )
    for name, text, options in (
        ("onvif", xml, ["--camera", "lobby"]),
        ("deepstream", frames, ["--size", "1900x900"]),
    ):
        file = tmp_path / name
        out = tmp_path / "out.jsonl"
        file.write_text(f"{text}rubbish\n")
        assert main(["ingest", name, str(file), *options, "--out", str(out)]) == exits.DONE
        places = [(e.camera, e.kind, e.x, e.y) for e in lines_of(out)]
        assert places == [("lobby", "entry", 0.5, 0.6), ("lobby", "exit", 0.5, 0.6)]
        assert "lines were rejected: malformed 1" in capsys.readouterr().err
