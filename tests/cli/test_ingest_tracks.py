"""`camtopod ingest` of tracks: one decision a track, late frames, places and names that cannot be.

A walker crosses the view from x = 0.02 to 0.98 in ten seconds, as several programs tell it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import frigate_messages as says
import pytest

from camtopod.adapt.axis import Axis
from camtopod.adapt.deepstream import DeepStream
from camtopod.adapt.onvif import Onvif
from camtopod.adapt.scenescape import SceneScape
from camtopod.cli import exits
from camtopod.cli.main import main
from camtopod.codec import event_from_json

T = 1_700_000_000.0
FRAMES = 150
"""Frames of a recording, ten a second; the walker is there from 2 s to 12 s."""
PASSAGE = [("entry", 2.0, 0.02), ("exit", 12.0, 0.98)]
SIZE = ["--size", "1000x500"]

Line = Callable[[float, float | None, str], Any]
"""Returns a frame at a time with the walker at x, if there is one, and its kind."""


def iso(t: float) -> str:
    return datetime.fromtimestamp(T + t, UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def axis(t: float, x: float | None, kind: str, unit: float = 1.0) -> Any:
    seen = []
    if x is not None:
        sides = {"left": x - 0.02, "right": x + 0.02, "top": 0.4, "bottom": 0.8}
        box = {side: unit * value for side, value in sides.items()}
        seen = [
            {"bounding_box": box, "track_id": "7", **({"class": {"type": kind}} if kind else {})}
        ]
    return {"frame": {"timestamp": iso(t), "observations": seen, "operations": []}}


def onvif(t: float, x: float | None, kind: str, unit: float = 1.0) -> Any:
    seen = []
    if x is not None:
        sides = {"@left": 2 * x - 1.04, "@right": 2 * x - 0.96, "@top": 0.2, "@bottom": -0.6}
        box = {side: unit * value for side, value in sides.items()}
        what = {"Class": {"Type": [{"#text": kind}]}} if kind else {}
        seen = [{"@ObjectId": 7, "Appearance": {"Shape": {"BoundingBox": box}, **what}}]
    return {"Frame": [{"@UtcTime": iso(t), "Object": seen}]}


def deepstream(t: float, x: float | None, kind: str) -> Any:
    seen = [] if x is None else [f"7|{1000 * x - 20}|200|{1000 * x + 20}|400|{kind}|#|"]
    return {"@timestamp": iso(t), "sensorId": "lobby", "objects": seen}


def scenescape(t: float, x: float | None, kind: str) -> Any:
    objects = {}
    if x is not None:
        box = {"x": 1000 * x - 20, "y": 200, "width": 40, "height": 200}
        objects = {kind: [{"id": 7, "bounding_box_px": box}]}
    return {"id": "lobby", "timestamp": iso(t), "objects": objects}


FORMATS: dict[str, tuple[Line, list[str]]] = {
    "axis": (axis, ["--camera", "lobby"]),
    "onvif": (onvif, ["--camera", "lobby"]),
    "deepstream": (deepstream, SIZE),
    "scenescape": (scenescape, SIZE),
    "scenescape --tracked": (scenescape, [*SIZE, "--tracked"]),
}


def walk(
    line: Line, kind_at: Callable[[float], str] = lambda _: "Human", start: float = 0.0
) -> list[Any]:
    """Return a recording that begins at ``start``; kind_at: seconds in view -> kind."""
    frames = []
    for n in range(FRAMES):
        x = round(0.02 + 0.0096 * (n - 20), 4) if 20 <= n <= 120 else None
        frames.append(line(start + n / 10, x, kind_at((n - 20) / 10)))
    return frames


def ingested(
    tmp_path: Path, line: str, messages: list[Any], *options: str
) -> tuple[int, list[Any]]:
    """Return the exit status of `camtopod ingest`, and the events."""
    source, out = tmp_path / "in", tmp_path / "out"
    source.write_text("".join(f"{m if isinstance(m, str) else json.dumps(m)}\n" for m in messages))
    status = main(["ingest", line.split()[0], str(source), *options, "--out", str(out)])
    return status, [event_from_json(text) for text in out.read_bytes().splitlines()]


def short(events: list[Any]) -> list[tuple[Any, ...]]:
    return [(e.kind, round(e.t - T, 3), e.x) for e in events]


# --- one decision a track -------------------------------------------------------------------------


def late(t: float) -> str:
    return "Human" if t >= 3 else ""


def flips_once(t: float) -> str:
    return "Human" if t < 5 else "Bicycle"


def alternates(t: float) -> str:
    return "Bicycle" if round(10 * t) % 2 else "Human"


def wrong_at_first(t: float) -> str:
    return "Bicycle" if t < 1.5 else "Human"


@pytest.mark.parametrize(
    ("name", "kind_at"),
    [(name, kind_at) for name in FORMATS for kind_at in (flips_once, alternates, wrong_at_first)]
    + [(name, late) for name in ("axis", "onvif", "deepstream")],
)
def test_a_track_is_one_passage_whatever_its_frames_call_it(
    tmp_path: Path, name: str, kind_at: Callable[[float], str]
) -> None:
    line, options = FORMATS[name]
    messages = walk(line, kind_at)
    assert short(ingested(tmp_path, name, messages, *options, "--label", "human")[1]) == PASSAGE
    assert short(ingested(tmp_path, name, messages, *options)[1]) == PASSAGE
    assert ingested(tmp_path, name, messages, *options, "--label", "car")[1] == []


@pytest.mark.parametrize("name", ["axis", "onvif", "deepstream"])
def test_what_is_found_to_be_a_part_late_has_no_event(tmp_path: Path, name: str) -> None:
    line, options = FORMATS[name]

    def kind_at(t: float) -> str:
        return "License_Plate" if t >= 3 else ""

    assert ingested(tmp_path, name, walk(line, kind_at), *options)[1] == []
    wanted = ingested(tmp_path, name, walk(line, kind_at), *options, "--label", "LicensePlate")
    assert short(wanted[1]) == PASSAGE


def test_a_part_that_is_in_view_at_the_start_has_no_exit(tmp_path: Path) -> None:
    """It has no entry to tell, so there is time to find out what it is."""
    messages = walk(axis, lambda t: "Face" if t >= 9 else "")[20:]
    assert ingested(tmp_path, "axis", messages, "--camera", "lobby")[1] == []


def test_what_is_never_classified_counts_and_a_cut_recording_keeps_its_entry(
    tmp_path: Path,
) -> None:
    messages = walk(axis, lambda _: "")
    for count, events in ((FRAMES, PASSAGE), (40, PASSAGE[:1])):
        found = ingested(tmp_path, "axis", messages[:count], "--camera", "lobby")[1]
        assert short(found) == events

    # The lateness is 5 s; and a camera that never tells kinds is not waited for again.
    adapter = Axis("lobby")
    told = []
    for start in (0.0, FRAMES / 10):
        for n, message in enumerate(walk(axis, lambda _: "", start)):
            events = adapter.receive(json.dumps(message).encode())
            told += [n / 10 - 2 for event in events if event.kind == "entry"]
    assert told == [4.0, 0.5]


def test_a_kind_that_is_told_once_is_kept_over_a_gap(tmp_path: Path) -> None:
    """ONVIF cameras need not classify an object in each frame."""
    messages = walk(onvif, lambda t: "Human" if t < 1 else "")
    for n in range(50, 80):
        messages[n] = onvif(n / 10, None, "")
    events = ingested(tmp_path, "onvif", messages, "--camera", "lobby", "--label", "Human")[1]
    assert [e.kind for e in events] == ["entry", "exit", "entry", "exit"]


def test_frigate_objects_are_judged_over_their_life(tmp_path: Path) -> None:
    def labelled(*labels: str) -> list[str]:
        lines = [json.loads(line) for line in says.passage(t=T)]
        for line, label in zip(lines, labels, strict=True):
            line["after"]["label"] = label
        return [json.dumps(line) for line in lines]

    def kinds(labels: tuple[str, ...], *options: str) -> list[str]:
        return [e.kind for e in ingested(tmp_path, "frigate", labelled(*labels), *options)[1]]

    person = ["--label", "Person"]
    assert kinds(("person", "car", "car"), *person) == ["entry", "exit"]
    assert kinds(("car", "person", "person"), *person) == ["entry", "exit"]
    assert kinds(("car", "car", "person"), *person) == []
    assert kinds(("license_plate",) * 3) == kinds(("face",) * 3) == []
    assert kinds(("face",) * 3, "--label", "face") == ["entry", "exit"]


def test_scenescape_ids_of_two_objects_are_no_tracks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """SceneScape's own adapter counts the objects of each kind from 1."""

    def both(t: float, x: float | None, kind: str) -> Any:
        message = scenescape(t, x, kind)
        car = {"id": 7, "bounding_box_px": {"x": 480, "y": 100, "width": 40, "height": 100}}
        message["objects"]["car"] = [car]
        return message

    assert short(ingested(tmp_path, "scenescape", walk(both), *SIZE)[1]) == PASSAGE
    ingested(tmp_path, "scenescape", walk(both), *SIZE, "--tracked")
    assert "two objects have one id, so they are not tracked: omit --tracked" in (
        capsys.readouterr().err
    )


# --- frames that come late ------------------------------------------------------------------------


@pytest.mark.parametrize("stall", [4.0, 25.0])
@pytest.mark.parametrize("sends_empty", [True, False])
@pytest.mark.parametrize("name", ["axis", "onvif", "deepstream", "scenescape"])
def test_frames_that_come_late_begin_no_track(name: str, sends_empty: bool, stall: float) -> None:
    """From 5 s on nothing comes for a while, then all in one burst."""
    adapter = {
        "axis": Axis("lobby"),
        "onvif": Onvif("lobby"),
        "deepstream": DeepStream({"": (1000, 500)}),
        "scenescape": SceneScape({"": (1000, 500)}, is_tracked=True),
    }[name]
    messages = walk(FORMATS[name][0])
    if not sends_empty:
        del messages[1:20], messages[-20:-1]
    events = []
    now = 1000.0
    for n, message in enumerate(messages):
        for _ in range(1 + (n == 50) * round(10 * stall)):
            now += 0.1
            events += adapter.silent(now)
        events += adapter.receive(json.dumps(message).encode())
    assert [e.kind for e in events].count("entry") == 1
    assert short(events[-1:]) == PASSAGE[1:]
    if sends_empty:
        assert short(events) == PASSAGE, "the camera tells of an empty view: nobody has left"


def test_this_program_may_stand_still_while_frames_wait() -> None:
    adapter = DeepStream({"": (1000, 500)})
    messages = walk(deepstream)[19:]  # without empty frames in front
    events = []
    for n, message in enumerate(messages):
        events += adapter.silent(n / 10 + 60.0 * (n > 40))
        events += adapter.receive(json.dumps(message).encode())
    assert short(events)[0][0] == "exit", "it was there at the start"
    assert len(events) == 1


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
    assert ingested(tmp_path, name, walk(line), *options) == (exits.DONE, [])
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
        (lambda x, y, w, h: [x, y, x + w, y + h], "reach far beyond the picture"),
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
    _, events = ingested(tmp_path, name, walk(line), *options)
    err = capsys.readouterr().err
    assert err.count(said) == 1
    assert "width, height in pixels" in err
    if "corners" not in said and "beyond" not in said:
        assert events == []


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
    source = tmp_path / "wrapped"
    source.write_text("".join(f"{json.dumps(message)}\n" for message in wrapped))
    options = ["--camera", "lobby", "--out", str(tmp_path / "none")]
    assert main(["ingest", "axis", str(source), *options]) == exits.INPUT
    assert "is no frame" in capsys.readouterr().err


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
