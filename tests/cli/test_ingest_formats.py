"""`camtopod ingest` of other formats: into a file, onto the bus, and lines that are refused."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

import frigate_messages as says
import pytest
from serving import T0

from camtopod.cli import exits
from camtopod.cli.main import main
from camtopod.codec import event_from_json
from camtopod.records import Event


def lines_of(path: Path) -> list[Event]:
    return [event_from_json(line) for line in path.read_bytes().splitlines()]


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
    assert f"{recording}:6: is neither a message nor a topic and a message" in err
    assert f"{recording}:10: " not in err, "one of a kind is enough"
    assert "3 of 33 lines were rejected: malformed 2, other-topic 1" in err
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
        ("frigate x.txt --size 4by4", "write it like 1280x720"),
        ("mot x.txt --rename a=b", "--rename is for frigate, scenescape, axis, onvif, deepstream"),
        ("frigate x.txt --fps 5", "--fps is for mot, not frigate"),
        ("scenescape x.txt --ca y.pem", "are for mqtt[s]:// only"),
        ("mot mqtt://h/m --camera a --fps 5 --size 4x4", "cannot be read from MQTT"),
        ("frigate mqtt://u:hunter2@h/frigate", "put it in a file"),
        ("frigate mqtt://h", "PREFIX"),
        ("frigate mqtt://h/frigate/#", "PREFIX"),
    ],
)
def test_usage(line: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ingest", *line.split(), "--out", "-"]) == exits.USAGE
    err = capsys.readouterr().err
    assert said in err
    assert "hunter2" not in err


def test_reading_that_fails_in_the_middle_is_no_success(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: Any, line: bytes) -> list[Event]:
        raise RuntimeError("nobody expected this")

    monkeypatch.setattr("camtopod.adapt.frigate.Frigate.receive", broken)
    with pytest.raises(RuntimeError, match="nobody expected this"):
        main(["ingest", "frigate", str(recording), "--out", str(tmp_path / "x")])


def test_cameras_that_send_xml_or_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """ONVIF and DeepStream from a file; a line that does not fit is counted."""
    box = '<BoundingBox left="-0.2" top="0.6" right="0.2" bottom="-0.2"/>'
    one = f'<Object ObjectId="7"><Appearance><Shape>{box}</Shape></Appearance></Object>'
    xml = "".join(
        f"<MetadataStream><VideoAnalytics>\n<Frame UtcTime="
        f'"2023-11-14T22:13:{n:02}Z">{one if 4 < n < 9 else ""}</Frame>\n'
        f"</VideoAnalytics></MetadataStream>\n"
        for n in range(15)
    )
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
