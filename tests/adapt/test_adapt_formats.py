"""Lines of Frigate, MOTChallenge and SceneScape become events.

The payloads follow the documentation of these programs.
"""

from __future__ import annotations

import json
import random
from datetime import UTC, datetime
from typing import Any

import frigate_messages as says
import pytest

from camtopod.adapt import adapter, camera_streams
from camtopod.adapt.adapter import Adapter
from camtopod.adapt.frigate import Frigate
from camtopod.adapt.mot import Mot
from camtopod.adapt.scenescape import SceneScape
from camtopod.codec import Rejected
from camtopod.records import Event

T = 1719000000.25
SIZES = {"": (says.WIDTH, says.HEIGHT)}


def read(reader: Adapter, lines: list[bytes]) -> list[Event]:
    return [event for line in lines for event in reader.receive(line)] + reader.close()


def short(events: list[Event]) -> list[tuple[Any, ...]]:
    return [(e.camera, e.kind, e.t, e.x, e.y) for e in events]


# --- Frigate --------------------------------------------------------------------------------------


@pytest.mark.parametrize("paths", [True, False])
def test_an_object_comes_in_where_it_was_first_seen_and_leaves_where_it_was_last_seen(
    paths: bool,
) -> None:
    events = read(Frigate(SIZES), says.passage(paths=paths))
    assert short(events) == [
        ("yard", "entry", T, 0.0469, 0.8333),
        ("yard", "exit", T + 8.2, 0.957, 0.8889),  # not five seconds later, when Frigate is sure
    ]
    assert {e.track for e in events} == {f"{T}-000000"}


def test_without_size_and_path_nothing_can_be_placed() -> None:
    reader = Frigate({"other": (640, 360)})
    with pytest.raises(Rejected, match="--size yard=WIDTHxHEIGHT") as caught:
        reader.receive(says.passage(paths=False)[0])
    assert caught.value.reason == "no-size"


def test_told_twice_counts_once_and_nothing_of_a_face_or_a_plate_is_kept() -> None:
    reader = Frigate(SIZES)
    lines = [line for n in range(20) for line in says.passage(n, T + n)]
    twice = [line for line in lines for _ in "12"] + lines[-6:]
    events = read(reader, twice)
    assert len(events) == 40
    for text in (repr(events), repr(vars(reader))):
        assert says.FACE not in text
        assert says.PLATE not in text


def test_what_stands_there_has_not_come_in_and_is_not_lost_by_leaving() -> None:
    assert read(Frigate(SIZES), says.parked(moved=0)) == []
    assert [e.kind for e in read(Frigate(SIZES), says.parked(moved=1))] == ["entry"], (
        "lost while it stood"
    )
    assert read(Frigate(SIZES), says.parked(moved=0, stationary=False)) == []


def test_who_moves_only_a_moment_after_being_found_comes_in_and_who_moves_much_later_does_not() -> (
    None
):
    for seconds, kinds in ((3.0, ["entry"]), (300.0, [])):
        first = says.seen(T, 10, 300, 110, 600, false_positive=True, position_changes=0)
        sure = says.seen(T + 0.8, 10, 300, 110, 600, position_changes=0)
        moves = says.seen(T + seconds, 200, 300, 300, 600, position_changes=1)
        lines = [says.message("new", first, sure), says.message("update", sure, moves)]
        events = read(Frigate(SIZES), lines)
        assert [e.kind for e in events] == kinds
        assert all(e.t == T for e in events)


def test_only_the_kinds_asked_for() -> None:
    lines = says.passage() + says.parked(moved=1)
    assert {e.track for e in read(Frigate(SIZES, ["car"]), lines)} == {f"{T}-parked"}
    assert len(read(Frigate(SIZES, ["person", "car"]), lines)) == 3


@pytest.mark.parametrize("where", ["before", "after"])
@pytest.mark.parametrize("moved", [0, 1])
def test_a_time_that_is_none_costs_no_other_message(where: str, moved: int) -> None:
    first, second, last = (json.loads(line) for line in says.passage())
    for message in (first["after"], second["before"]):
        message["position_changes"] = moved
    wild = json.loads(json.dumps(second))
    wild[where]["frame_time"] = 1e300
    reader = Frigate(SIZES)
    events = reader.receive(json.dumps(first).encode())
    with pytest.raises(Rejected, match="between 1970 and 3000"):
        reader.receive(json.dumps(wild).encode())
    for message in (second, last):
        events += reader.receive(json.dumps(message).encode())
    assert [event.kind for event in events] == ["entry", "exit"]


def test_mosquitto_sub_may_put_the_topic_in_front() -> None:
    lines = [b"home/frigate/events " + line for line in says.passage()]
    assert len(read(Frigate(SIZES), lines)) == 2
    for line, reason in (
        (b"frigate/yard/person 1", "other-topic"),
        (b"frigate/events online", "malformed"),
        (b"online", "malformed"),
        (b'{"type": "new"}', "bad-value"),
        (says.message("start", says.seen(T, 1, 2, 3, 4), says.seen(T, 1, 2, 3, 4)), "bad-value"),
        (says.message("new", says.seen(T, 1, 2, 3, 4), says.seen(1e30, 1, 2, 3, 4)), "bad-value"),
        (
            says.message("new", says.seen(T, 1, 2, 3, 4), says.seen(T, 1, 2, 3, 4, camera="a/b")),
            "bad-value",
        ),
    ):
        with pytest.raises(Rejected) as caught:
            read(Frigate(SIZES), [line])
        assert caught.value.reason == reason, line


# --- MOTChallenge ---------------------------------------------------------------------------------


def mot_lines(frames: int = 60) -> list[bytes]:
    """Return three people in a picture of 1920x1080, sorted by track, and lines that
    do not count.
    """
    lines = []
    lines += [f"{frame},1,{20 * frame},400,80.5,200,1,1,0.9" for frame in range(15, frames)]
    lines += [f"{frame},2,900,{300 + frame},80,200,1,1,1" for frame in range(1, 40)]
    lines += [f"{frame},5,100,100,50,50,1" for frame in range(45, frames)]
    for frame in range(5, 50):
        lines += [f"{frame},3,0,0,50,90,0,7,1", f"{frame}, -1, 5.5, 6, 7, 8, 0.7, -1, -1, -1"]
    return [line.encode() for line in lines]


def test_mot_lines_become_events_by_time_whatever_their_order() -> None:
    expected = [
        ("gate", "entry", 1001.4, 0.1772, 0.5556),
        ("gate", "exit", 1003.8, 0.4896, 0.4991),
        ("gate", "entry", 1004.4, 0.0651, 0.1389),
    ]
    assert short(read(Mot("gate", (1920, 1080), 10, 1000.0), mot_lines())) == expected
    lines = mot_lines()
    random.Random(1).shuffle(lines)
    assert short(read(Mot("gate", (1920, 1080), 10, 1000.0), lines)) == expected


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"1,2,3", "malformed"),
        (b"frame,id,left,top,width,height", "malformed"),
        (b"1,2,3,4,-5,6,1", "bad-value"),
        (b"1,2,nan,4,5,6,1", "bad-value"),
        (b"1e300,2,3,4,5,6,1", "bad-value"),
    ],
)
def test_mot_lines_that_make_no_sense(line: bytes, reason: str) -> None:
    reader = Mot("gate", (1920, 1080), 10, 0.0)
    with pytest.raises(Rejected) as caught:
        reader.receive(line)
    assert caught.value.reason == reason
    assert reader.close() == []


# --- SceneScape -----------------------------------------------------------------------------------


def frame(
    t: float, people: list[tuple[int, int]], camera: str = "cam1", tracked: bool = False
) -> bytes:
    """Return a message of a camera at ``t``: people as (id, left edge), in changing order."""
    chance = random.Random(f"{t}")
    listed = sorted(people, key=lambda _: chance.random())
    persons = [
        {
            "id": number if tracked else 1 + place,
            "category": "person",
            "confidence": 0.99,
            "center_of_mass": {"x": left, "y": 100, "width": 20.0, "height": 50.0},
            "bounding_box_px": {"x": left, "y": 100, "width": 60, "height": 200},
            "metadata": {
                "age": {"label": "39", "model_name": "age_gender"},
                "reid": {"embedding_vector": "AAAA", "model_name": "torch"},
            },
        }
        for place, (number, left) in enumerate(listed)
    ]
    stamp = datetime.fromtimestamp(t, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    message = {
        "id": camera,
        "timestamp": stamp,
        "debug_mac": "02:42:ac:11:00:05",
        "rate": 10.0,
        "objects": {"person": persons} if persons else {},
    }
    return json.dumps(message).encode()


def walks(tracked: bool) -> list[bytes]:
    """Return walks from the left and from the right; their order in the list alternates."""
    lines = []
    for n in range(130):
        left = [(41, 8 * (n - 15))] if 15 <= n < 90 else []
        right = [(17, 740 - 8 * (n - 30))] if 30 <= n < 110 else []
        lines.append(frame(1_700_000_000 + n / 10, left + right, tracked=tracked))
    return lines


@pytest.mark.parametrize("tracked", [True, False])
def test_scenescape_frames_become_passages(tracked: bool) -> None:
    events = read(SceneScape({"cam1": (800, 600)}, tracked=tracked), walks(tracked))
    t = 1_700_000_000
    assert sorted(short(events)) == [
        ("cam1", "entry", t + 1.5, 0.0375, 0.5),
        ("cam1", "entry", t + 3.0, 0.9625, 0.5),
        ("cam1", "exit", t + 8.9, 0.7775, 0.5),
        ("cam1", "exit", t + 10.9, 0.1725, 0.5),
    ]
    assert len({e.track for e in events}) == 2
    if tracked:
        assert {(e.track, e.x) for e in events if e.kind == "entry"} == {
            ("person-41", 0.0375),
            ("person-17", 0.9625),
        }


def test_ids_that_only_count_are_not_believed() -> None:
    """If they were, both people would appear to turn round half-way."""

    def passages(reader: SceneScape) -> set[tuple[float | None, ...]]:
        events = read(reader, walks(tracked=False))
        return {
            tuple(e.x for e in events if e.track == track) for track in {e.track for e in events}
        }

    through = {(0.0375, 0.7775), (0.9625, 0.1725)}
    assert passages(SceneScape({"": (800, 600)})) == through
    assert passages(SceneScape({"": (800, 600)}, tracked=True)) != through


def test_cameras_and_kinds_are_apart() -> None:
    lines = [
        line
        for n in range(60)
        for line in (
            frame(T + n / 10, [(1, 100)] if 15 < n < 30 else [], camera) for camera in ("a", "b")
        )
    ]
    lines = [b"scenescape/data/camera/x " + line for line in lines]
    events = read(SceneScape({"": (800, 600)}), lines)
    assert sorted((e.camera, e.kind) for e in events) == [
        (c, k) for c in "ab" for k in ("entry", "exit")
    ]
    assert read(SceneScape({"": (800, 600)}, ["vehicle"]), lines) == []


def test_a_frame_that_comes_too_late_changes_nothing() -> None:
    """It would mislead the track of the person in view."""
    size = {"": (2000, 600)}
    lines = [frame(T + n / 10, [(1, 40 * n)] if 15 <= n < 40 else []) for n in range(70)]
    expected = read(SceneScape(size), lines)
    assert [event.kind for event in expected] == ["entry", "exit"]
    reader, events = SceneScape(size), []
    for n, line in enumerate(lines):
        events += reader.receive(line)
        for late in (n - 3, n - 6, n - 9) if n == 30 else ():  # what has waited somewhere
            with pytest.raises(Rejected, match="a later frame"):
                reader.receive(lines[late])
    assert events + reader.close() == expected


def test_scenescape_lines_that_make_no_sense(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_streams, "STREAMS_MAX", 1)
    monkeypatch.setattr(camera_streams, "TRACKS_MAX", 3)
    reader = SceneScape({"": (800, 600)})
    person = {"id": 1, "bounding_box": {"x": -0.1, "y": 0.2, "width": 0.1, "height": 0.4}}
    lens = {"id": "cam1", "timestamp": "2026-01-01T00:00:00Z", "objects": {"person": [person]}}
    assert reader.receive(frame(T, [(1, 100)])) == []
    for line, reason in (
        (frame(T, [], "cam3"), "too-many-cameras"),
        (frame(T - 1, []), "out-of-order"),
        (json.dumps(lens).encode(), "no-pixels"),
        (frame(T, [(1, 1), (2, 1), (3, 1), (4, 1)]), "too-many"),
        (json.dumps({**lens, "timestamp": "0001-01-01T00:00:00Z"}).encode(), "bad-value"),
        (json.dumps({**lens, "timestamp": None}).encode(), "bad-value"),
        (json.dumps({**lens, "objects": []}).encode(), "bad-value"),
        (b"scenescape/regulated/scene/1 {}", "other-topic"),
    ):
        with pytest.raises(Rejected) as caught:
            reader.receive(line)
        assert caught.value.reason == reason, line
    with pytest.raises(Rejected, match="--size cam1"):
        SceneScape({}).receive(frame(T, []))


# --- all ------------------------------------------------------------------------------------------


def test_what_is_quoted_of_a_line_names_nobody() -> None:
    for line in (
        *says.passage(),
        b"frigate/yard/last_face Jane Doe",
        b"Jane Doe",
        b"Jane",
        b'{"a": "Jane',
    ):
        assert b"Jane" not in adapter.quotable(line)
        assert says.PLATE.encode() not in adapter.quotable(line)
    assert adapter.quotable(b'{"a": "x\\"y", "b": 1.5, "c') == b'{"a": "...", "b": 1.5, "..."'
    assert adapter.quotable(b"1,2,x,4") == b"1,2,x,4"
    assert adapter.quotable(b"frigate/yard/person 1") == b"frigate/yard/person ..."
