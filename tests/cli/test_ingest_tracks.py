"""`camtopod ingest` of tracks: one decision a track, and late frames."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import frigate_messages as says
import pytest
from tracked_walks import (
    FORMATS,
    FRAMES,
    PASSAGE,
    SIZE,
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
from camtopod.adapt.deepstream import DeepStream
from camtopod.adapt.onvif import Onvif
from camtopod.adapt.scenescape import SceneScape


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
