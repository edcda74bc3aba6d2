"""`camtopod ingest` of tracks: names of cameras that are no ids, and where they stand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import frigate_messages as says
import pytest
from tracked_walks import (
    FORMATS,
    PASSAGE,
    SIZE,
    T,
    axis,
    deepstream,
    ingested,
    iso,
    short,
    walk,
)

from camtopod.cli import exits
from camtopod.cli.main import main
from camtopod.codec import event_from_json

# --- names ----------------------------------------------------------------------------------------


def named(name: str, camera: str) -> tuple[str, list[Any], list[str]]:
    """Return a format's recording of a camera, and its options."""
    line, options = FORMATS[name]
    messages = walk(line)
    if name == "axis":
        return name, [f"axis/{camera} {json.dumps(m)}" for m in messages], []
    if name == "onvif":
        topic = f"{camera}/onvif-mj/VideoAnalytics/1/Module"
        return name, [f"{topic} {json.dumps(m)}" for m in messages], []
    key = "id" if name == "scenescape" else "sensorId"
    return name, [{**m, key: camera} for m in messages], options


@pytest.mark.parametrize("name", ["axis", "onvif", "deepstream", "scenescape"])
def test_other_programs_names_become_ids(tmp_path: Path, name: str) -> None:
    for called, options, expected in (
        ("Front Door", [], "front_door"),
        ("Kamera S\u00fcd", [], "kamera_sud"),
        ("MyDevice", [], "MyDevice"),
        ("Front Door", ["--rename", "Front Door=gate"], "gate"),
        ("A#1=\u5317", ["--rename", "A#1=\u5317=north"], "north"),
    ):
        given, messages, more = named(name, called)
        events = ingested(tmp_path, given, messages, *more, *options)[1]
        assert {e.camera for e in events} == {expected}
        assert short(events) == PASSAGE


@pytest.mark.parametrize("name", ["axis", "onvif", "deepstream", "scenescape", "frigate"])
def test_two_programs_cameras_of_one_name_are_two(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    def topic(place: str) -> str:
        behind = {
            "axis": "front",
            "onvif": "front/onvif-mj/VideoAnalytics/1/Module",
            "deepstream": "messages",
            "scenescape": "data/camera/front",
            "frigate": "events",
        }
        return f"{place}/{behind[name]}"

    if name == "frigate":
        options: list[str] = []
        messages = [line.decode() for line in says.passage(t=T, camera="front")]
    else:
        line, options = FORMATS[name]
        key = "id" if name == "scenescape" else "sensorId"
        messages = [json.dumps({**m, key: "front"} if options == SIZE else m) for m in walk(line)]
        options = [] if name in ("axis", "onvif") else options
    lines = [f"{topic(place)} {m}" for m in messages for place in ("home/house", "home/barn")]
    whole = topic("home/barn") if name == "deepstream" else "home/barn"

    status, events = ingested(tmp_path, name, lines, *options)
    assert (status, {e.camera for e in events}) == (exits.FAILED, {"front"})
    assert len(events) == 2
    said = capsys.readouterr().err
    assert f"and '{whole}/front' would both be front: give --rename" in said

    status, events = ingested(tmp_path, name, lines, *options, "--rename", f"{whole}/front=barn")
    assert (status, {e.camera for e in events}) == (exits.DONE, {"front", "barn"})
    assert len(events) == 4


def test_frigate_cameras_have_ids_and_sizes_by_them(tmp_path: Path) -> None:
    lines = [line.decode() for line in says.passage(t=T, camera="Front Yard", paths=False)]
    events = ingested(tmp_path, "frigate", lines, "--size", "front_yard=1280x720")[1]
    assert [(e.camera, e.kind) for e in events] == [("front_yard", "entry"), ("front_yard", "exit")]


@pytest.mark.parametrize(
    ("names", "options", "said"),
    [
        (["Tor #1"], [], "camera 'Tor #1': an id is 1 to 64 of the characters"),
        (["Front Door", "front door"], [], "cameras 'Front Door' and 'front door' would both be"),
        (["a", "b"], ["--rename", "b=a"], "cameras 'a' and 'b' would both be a"),
        (["a", "b"], ["--camera", "c"], "cameras 'a' and 'b' would both be c"),
        ([""], [], "names no camera: give --camera ID"),
    ],
)
def test_names_that_cannot_be_ids_are_said(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    names: list[str],
    options: list[str],
    said: str,
) -> None:
    messages = [{**message, "sensorId": name} for message in walk(deepstream) for name in names]
    source = tmp_path / "in"
    source.write_text("".join(f"{json.dumps(message)}\n" for message in messages))
    out = tmp_path / "out"
    status = main(["ingest", "deepstream", str(source), *SIZE, *options, "--out", str(out)])
    assert said in capsys.readouterr().err
    if len(names) == 1:
        assert status == exits.INPUT
    else:
        events = [event_from_json(text) for text in out.read_bytes().splitlines()]
        assert short(events) == PASSAGE, "of the camera that had the name first"


# --- AXIS: what is a frame, and where the camera's name stands ------------------------------------


def test_other_json_is_no_empty_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    foreign = {"timestamp": iso(0), "topic": "axis/lobby", "payload": {"level": 3}}
    mixed = [each for message in walk(axis) for each in (message, foreign)]
    assert short(ingested(tmp_path, "axis", mixed, "--camera", "lobby")[1]) == PASSAGE
    assert "150 of 300 lines were rejected: malformed 150" in capsys.readouterr().err

    wrapped = [{**foreign, "payload": message} for message in walk(axis)]
    assert short(ingested(tmp_path, "axis", wrapped)[1]) == PASSAGE, "beside its topic"


@pytest.mark.parametrize(
    ("topic", "camera"),
    [
        ("axis/frame_shop", "frame_shop"),
        ("axis/frames", "frames"),
        ("axis/object_track_room", "object_track_room"),
        ("axis/com.axis", "com.axis"),
        ("axis/lobby/frame", "lobby"),
        ("axis/lobby/com.axis.scene.frame.v1", "lobby"),
        ("axis/lobby/com.axis.analytics_scene_description.v0.beta#1", "lobby"),
    ],
)
def test_a_topic_level_is_the_kind_of_data_as_a_whole_word_only(
    tmp_path: Path, topic: str, camera: str
) -> None:
    messages = [f"{topic} {json.dumps(message)}" for message in walk(axis)]
    assert {e.camera for e in ingested(tmp_path, "axis", messages)[1]} == {camera}
