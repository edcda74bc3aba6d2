"""`camtopod ingest` of tracks: boxes outside the picture, in other units, and at wrong times."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import frigate_messages as says
import pytest
from tracked_walks import (
    FORMATS,
    PASSAGE,
    Line,
    T,
    axis,
    deepstream,
    ingested,
    onvif,
    scenescape,
    short,
    walk,
)

from camtopod.adapt.axis import Axis
from camtopod.adapt.tracks import TrackEvents
from camtopod.cli import exits
from camtopod.cli.main import main

# --- places outside the picture -------------------------------------------------------------------


def axis_pixels(t: float, x: float | None, kind: str) -> Any:
    return axis(t, x, kind, 1000.0)


def onvif_pixels(t: float, x: float | None, kind: str) -> Any:
    return onvif(t, x, kind, 1000.0)


def mot(t: float, x: float | None, _: str) -> Any:
    return f"{1 + round(10 * t)},7,{1000 * (x or 0.5) - 20},200,40,200,{int(x is not None)}"


@pytest.mark.parametrize(
    ("name", "line", "options", "said"),
    [
        ("deepstream", deepstream, ["--size", "320x180"], "is --size right?"),
        ("scenescape", scenescape, ["--size", "lobby=320x180"], "is --size right?"),
        ("mot", mot, ["--size", "320x180", "--camera", "lobby", "--fps", "10"], "is --size right?"),
        ("onvif", onvif_pixels, ["--camera", "lobby"], "no Transformation"),
        ("axis", axis_pixels, ["--camera", "lobby"], "not in fractions of the picture"),
    ],
)
def test_boxes_outside_the_picture_are_said_once_and_not_used(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    line: Line,
    options: list[str],
    said: str,
) -> None:
    assert ingested(tmp_path, name, walk(line), *options) == (exits.INPUT, [])
    err = capsys.readouterr().err
    assert err.count("boxes lie outside the picture and are not used") == 1
    assert "camera lobby" in err
    assert said in err


def test_a_box_that_reaches_a_little_beyond_the_border_is_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    size = ["--size", "1000x370"]  # the foot is at 400
    events = ingested(tmp_path, "deepstream", walk(deepstream), *size)[1]
    assert [(e.kind, e.y) for e in events] == [("entry", 1.0), ("exit", 1.0)]
    assert "outside" not in capsys.readouterr().err


# --- boxes that cannot be right -------------------------------------------------------------------


def in_unit(line: Line, change: Callable[[float, float, float, float], list[float]]) -> Line:
    """Return messages of SceneScape or MOT whose boxes (x, y, width, height) are others."""

    def written(t: float, x: float | None, kind: str) -> Any:
        numbers = change(1000 * (x or 0.5) - 20, 200, 40, 200)
        if line is mot:
            return f"{1 + round(10 * t)},7,{','.join(map(str, numbers))},{int(x is not None)}"
        message = scenescape(t, x, kind)
        for objects in message["objects"].values():
            objects[0]["bounding_box_px"] = dict(
                zip(("x", "y", "width", "height"), numbers, strict=True)
            )
        return message

    return written


@pytest.mark.parametrize("name", ["mot", "scenescape --tracked"])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda x, y, w, h: [x, y, 0, 0], "have no area"),
        (lambda x, y, w, h: [x / 1000, y / 1000, w / 1000, h / 1000], "less than a pixel"),
        (lambda x, y, w, h: [x, y, x + w, y + h], "none is used"),
    ],
    ids=["no area", "fractions for pixels", "corners for sizes"],
)
def test_boxes_in_another_unit_are_counted_and_said(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    change: Callable[[float, float, float, float], list[float]],
    said: str,
) -> None:
    options = ["--size", "1000x500"]
    options += ["--camera", "lobby", "--fps", "10"] if name == "mot" else ["--tracked"]
    line = in_unit(mot if name == "mot" else scenescape, change)
    status, events = ingested(tmp_path, name, walk(line), *options)
    err = capsys.readouterr().err
    assert status == (exits.FAILED if "lines were accepted" in err else exits.INPUT)
    assert err.count(said) == 1
    assert "width, height in pixels" in err
    assert events[1 + (name != "mot") :] == [], "live, the first boxes tell nothing yet"


@pytest.mark.parametrize(
    ("name", "said"),
    [("mot", "have a negative id or confidence 0"), ("deepstream", "101 boxes have no track")],
)
def test_a_recording_without_a_box_of_a_track_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, said: str
) -> None:
    def untracked(t: float, x: float | None, kind: str) -> Any:
        if name == "mot":
            return mot(t, None, kind)
        message = deepstream(t, x, kind)
        message["objects"] = [text.replace("7|", "-1|", 1) for text in message["objects"]]
        return message

    options = ["--camera", "lobby", "--fps", "10"] if name == "mot" else []
    status, events = ingested(tmp_path, name, walk(untracked), "--size", "1000x500", *options)
    assert (status, events) == (exits.INPUT, [])
    assert said in capsys.readouterr().err


def test_sizes_for_corners_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At the left border they look like corners, too."""

    def sizes(t: float, x: float | None, kind: str) -> Any:
        message = deepstream(t, x, kind)
        message["objects"] = [f"7|{1000 * (1 - x) - 20}|20|40|200|{kind}"] if x else []
        return message

    status, events = ingested(tmp_path, "deepstream", walk(sizes), "--size", "1000x500")
    assert (status, events) == (exits.INPUT, [])
    said = capsys.readouterr().err
    assert "are they left, top, right, bottom in pixels?" in said
    assert "boxes of lobby are sizes for corners, or corners for sizes: none is used" in said


@pytest.mark.parametrize(
    "box", [[5, 4, 240, 300], [-300, 4, 240, 300], [-300, -300, 1300, 900], [300, 100, 800, 700]]
)
def test_large_boxes_and_those_in_a_corner_are_used(box: list[float]) -> None:
    tracks = TrackEvents("lobby", (1000, 500), outside_max=0.1)
    for frame in range(100):
        tracks.update(["7"] if frame > 20 else [], [box] if frame > 20 else [], frame / 10)
    tracks.update([], [], 60.0)
    assert (tracks.entries, tracks.exits) == (1, 1)


def test_boxes_that_have_been_mended_are_used_again() -> None:
    tracks = TrackEvents("lobby", (1000, 500))
    tracks.update([], [], 0.0)
    for frame in range(400):
        box = [500, 200, 40 if frame < 100 else 540, 400]
        tracks.update(["7" if frame < 300 else "8"], [box], 2.0 + frame / 10)
        assert tracks.is_misread == (19 <= frame < 300)
    tracks.update([], [], 60.0)
    assert (tracks.entries, tracks.exits) == (2, 2)


# --- objects that do not count, frames that come late ---------------------------------------------


@pytest.mark.parametrize("name", FORMATS)
def test_it_is_said_if_no_object_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    line, options = FORMATS[name]
    _, events = ingested(tmp_path, name, walk(line, lambda _: "Cat"), *options, "--label", "Human")
    assert events == []
    assert "of 1 objects none counts by --label: 1 Cat" in capsys.readouterr().err
    ingested(tmp_path, name, walk(line), *options, "--label", "Human")
    assert "none counts" not in capsys.readouterr().err


def test_it_is_said_live_after_a_hundred_objects() -> None:
    adapter = Axis("lobby", ["Human"])
    said: list[str] = []
    adapter.say = said.append
    for k in range(150):
        for message in walk(axis, lambda _: "", start=20.0 * k):
            adapter.receive(json.dumps(message).encode())
    assert len(said) == 1
    assert re.match("of 10[0-9] objects none counts by --label: 10[0-9] without a kind", said[0])


@pytest.mark.parametrize("name", ["axis", "onvif", "deepstream", "scenescape --tracked"])
@pytest.mark.parametrize("seconds", [-1.0, -4.0, -1e8, 1e8, 7200.0, 0.0])
def test_a_frame_with_a_wrong_time_changes_nothing(
    tmp_path: Path, name: str, seconds: float
) -> None:
    """Nor one that comes again."""
    line, options = FORMATS[name]
    messages = walk(line)
    kind = "Human"
    wrong = line(8.0 + seconds, 0.3, kind) if seconds else messages[79]
    messages.insert(80, wrong)
    assert short(ingested(tmp_path, name, messages, *options)[1]) == PASSAGE


def test_a_frame_that_comes_again_after_a_silence_is_no_second_exit() -> None:
    adapter = Axis("lobby", [])
    events = []
    messages = walk(axis)
    for message in [messages[0], *messages[20:100]]:  # it sends nothing while the view is empty
        events += adapter.receive(json.dumps(message).encode())
    for second in range(5):
        events += adapter.silent(float(second))
    events += adapter.receive(json.dumps(messages[99]).encode())
    for second in range(5, 10):
        events += adapter.silent(float(second))
    assert [event.kind for event in events + adapter.close()] == ["entry", "exit"]


def test_frigate_positions_outside_the_picture_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [line.decode() for line in says.passage(t=T)]
    source, out = tmp_path / "in", tmp_path / "out"
    source.write_text("\n".join(lines))
    assert main(["ingest", "frigate", str(source), "--size", "320x180", "--out", str(out)]) == 1
    assert out.read_bytes() == b""
    assert "outside the picture: is --size right?" in capsys.readouterr().err


def test_a_file_of_frames_in_an_envelope_is_no_table(tmp_path: Path) -> None:
    def enveloped(t: float, x: float | None, kind: str) -> Any:
        return {"data": axis(t, x, kind)}

    assert short(ingested(tmp_path, "axis", walk(enveloped), "--camera", "a")[1]) == PASSAGE
