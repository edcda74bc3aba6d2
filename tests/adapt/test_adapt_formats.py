"""Lines of other programs become events: Frigate, MOTChallenge, SceneScape, AXIS, ONVIF, DeepStream.

The messages follow the documentation of these programs; where they are from is said beside them.
"""

from __future__ import annotations

import contextlib
import json
import random
from collections.abc import Iterator
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any

import frigate_messages as says
import pytest
from hypothesis import given, settings, strategies as st

from camtopod.adapt import (
    FORMATS,
    LINE_BYTES_MAX,
    camera_names,
    camera_streams,
    frames,
)
from camtopod.adapt.adapter import Adapter
from camtopod.adapt.axis import Axis
from camtopod.adapt.camera_streams import seconds_of
from camtopod.adapt.deepstream import DeepStream
from camtopod.adapt.frigate import Frigate
from camtopod.adapt.mot import Mot
from camtopod.adapt.onvif import Onvif
from camtopod.adapt.scenescape import SceneScape
from camtopod.cli.events.event_lines import LineReader
from camtopod.codec import Rejected
from camtopod.records import Event

T = 1_700_000_000.0
SIZES = {"": (says.WIDTH, says.HEIGHT)}
OPTIONS = SimpleNamespace(
    size=[("", (1920, 1080))], label=[], camera="gate", tracked=False, fps=10.0, start=None
)


def iso(t: float) -> str:
    return datetime.fromtimestamp(t, UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def read(adapter: Adapter, lines: list[bytes]) -> list[Event]:
    return [event for line in lines for event in adapter.receive(line)] + adapter.close()


def short(events: list[Event]) -> list[tuple[Any, ...]]:
    return [(e.camera, e.kind, round(e.t - T, 3), e.x, e.y, e.track) for e in events]


def refused(adapter: Adapter, line: bytes) -> str:
    with pytest.raises(Rejected) as caught:
        adapter.receive(line)
    return caught.value.reason


# --- Frigate --------------------------------------------------------------------------------------


@pytest.mark.parametrize("paths", [True, False])
def test_frigate_entry_is_at_the_first_sighting_and_exit_at_the_last(paths: bool) -> None:
    events = read(Frigate(SIZES), says.passage(t=T, paths=paths))

    track = f"{T}-000000"
    assert short(events) == [
        ("yard", "entry", 0.0, 0.0469, 0.8333, track),
        ("yard", "exit", 8.2, 0.957, 0.8889, track),  # not 5 s later, when Frigate is sure
    ]


def test_frigate_message_told_twice_counts_once_and_nothing_of_faces_is_kept() -> None:
    adapter = Frigate(SIZES)
    lines = [line for n in range(20) for line in says.passage(n, T + n)]

    events = read(adapter, [line for line in lines for _ in "12"] + lines[-6:])

    assert len(events) == 40
    for text in (repr(events), repr(vars(adapter))):
        assert says.FACE not in text
        assert says.PLATE not in text


def test_frigate_object_that_stands_has_not_entered_and_is_not_lost() -> None:
    def kinds(lines: list[bytes]) -> list[str]:
        return [event.kind for event in read(Frigate(SIZES), lines)]

    assert kinds(says.parked(moved=0)) == kinds(says.parked(moved=0, stationary=False)) == []
    assert kinds(says.parked(moved=1)) == ["entry"], "lost while it stood"
    for seconds, entries in ((3.0, ["entry"]), (300.0, [])):
        first = says.seen(T, 10, 300, 110, 600, false_positive=True, position_changes=0)
        sure = says.seen(T + 0.8, 10, 300, 110, 600, position_changes=0)
        moves = says.seen(T + seconds, 200, 300, 300, 600, position_changes=1)
        lines = [says.message("new", first, sure), says.message("update", sure, moves)]
        assert kinds(lines) == entries


@pytest.mark.parametrize(
    "line",
    [
        "2023-11-14T22:13:2{n}.000000+0100 frigate/events {message}",
        "170000000{n}.25 frigate/events {message}",
        "2023-11-14 22:13:2{n}\tfrigate/events\t{message}",
        '{{"tst": "{n}", "topic": "frigate/events", "qos": 0, "payload": {message}}}',
        '{{"topic": "frigate/events", "payload": {quoted}}}',
    ],
)
def test_messages_are_read_as_mqtt_clients_log_them(line: str) -> None:
    """With the time at which each came, or in JSON beside the topic."""
    messages = [message.decode() for message in says.passage()]
    lines = [
        line.format(n=n, message=message, quoted=json.dumps(message)).encode()
        for n, message in enumerate(messages)
    ]
    assert read(Frigate(SIZES), lines) == read(Frigate(SIZES), says.passage())


def test_frigate_lines_of_other_kinds_and_topics() -> None:
    lines = [b"home/frigate/events " + line for line in says.passage() + says.parked(moved=1)]
    assert len(read(Frigate(SIZES, ["person", "car"]), lines)) == 3
    assert len(read(Frigate(SIZES, ["car"]), lines)) == 1

    box = says.seen(T, 1, 2, 3, 4)
    for line, reason in (
        (b"frigate/tracked_object_update {}", "other-topic"),
        (b"frigate/events online", "malformed"),
        (b"frigate/available online", "other-topic"),
        (b'{"topic": "frigate/stats", "payload": {"a": 1}}', "other-topic"),
        (b'{"type": "new"}', "bad-value"),
        (b'{"id": "1", "camera": "yard", "start_time": 1, "data": {}}', "bad-value"),
        (says.message("start", box, box), "bad-value"),
        (says.message("new", box, says.seen(1e30, 1, 2, 3, 4)), "bad-value"),
        (says.message("new", says.seen(1e30, 1, 2, 3, 4), box), "bad-value"),
        (says.message("new", box, says.seen(T, 1, 2, 3, 4, camera="a/b")), "no-camera"),
    ):
        assert refused(Frigate(SIZES), line) == reason, line
    assert refused(Frigate({"other": (640, 360)}), says.passage(paths=False)[0]) == "no-size"


# --- MOTChallenge ---------------------------------------------------------------------------------


def mot_lines(frames: int = 60) -> list[bytes]:
    """Return three people in a picture of 1920x1080, sorted by track, and lines that do not
    count.
    """
    lines = [f"{frame},1,{20 * frame},400,80.5,200,1,1,0.9" for frame in range(15, frames)]
    lines += [f"{frame},2,900,{300 + frame},80,200,1,1,1" for frame in range(1, 40)]
    lines += [f"{frame},5,100,100,50,50,1" for frame in range(45, frames)]
    for frame in range(5, 50):
        lines += [f"{frame},3,0,0,50,90,0,7,1", f"{frame}, -1, 5.5, 6, 7, 8, 0.7, -1, -1, -1"]
    return [line.encode() for line in lines]


def test_mot_refuses_rows_of_the_ai_city_challenge_by_name() -> None:
    """Nine columns, too: camera, id, frame, left, top, width, height and a place in the world."""
    adapter = Mot("gate", {"gate": (1920, 1080)}, 10.0, 0.0)
    for line in (b"41 7 130 1201 530 88 190 42.52 -90.7", b"c041 7 130 1201 530 88 190 -1 -1"):
        with pytest.raises(Rejected, match="AI City Challenge"):
            adapter.receive(line)
    for line in (b"1,7,1201,530,88,190,1,1,0.4", b"1 7 1201 530 88 190 0 1 1"):
        assert adapter.receive(line) == [], "the ground truth of MOTChallenge"


def test_mot_lines_become_events_by_time_whatever_their_order() -> None:
    lines = mot_lines()
    random.Random(1).shuffle(lines)

    for each in (mot_lines(), lines):
        assert short(read(Mot("gate", {"": (1920, 1080)}, 10, T), each)) == [
            ("gate", "entry", 1.4, 0.1772, 0.5556, "1"),
            ("gate", "exit", 3.8, 0.4896, 0.4991, "2"),
            ("gate", "entry", 4.4, 0.0651, 0.1389, "5"),
        ]


# --- SceneScape -----------------------------------------------------------------------------------


def scene(
    t: float, people: list[tuple[int, int]], camera: str = "cam1", tracked: bool = False
) -> bytes:
    """Return a message of a camera: people as (id, left edge), in changing order."""
    listed = sorted(people, key=lambda _: random.Random(f"{t}").random())
    persons = [
        {
            "id": number if tracked else 1 + place,
            "bounding_box_px": {"x": left, "y": 100, "width": 60, "height": 200},
            "metadata": {"age": {"label": "39", "model_name": "age_gender"}},
        }
        for place, (number, left) in enumerate(listed)
    ]
    objects = {"person": persons} if persons else {}
    return json.dumps({"id": camera, "timestamp": iso(T + t), "objects": objects}).encode()


@pytest.mark.parametrize("tracked", [True, False])
def test_scenescape_frames_become_passages(tracked: bool) -> None:
    lines = []
    for n in range(130):
        people = [(41, 8 * (n - 15))] if 15 <= n < 90 else []
        people += [(17, 740 - 8 * (n - 30))] if 30 <= n < 110 else []
        lines.append(scene(n / 10, people, tracked=tracked))

    events = read(SceneScape({"cam1": (800, 600)}, is_tracked=tracked), lines)

    assert [(e.kind, round(e.t - T, 3), e.x) for e in events] == [
        ("entry", 1.5, 0.0375),
        ("entry", 3.0, 0.9625),
        ("exit", 8.9, 0.7775),
        ("exit", 10.9, 0.1725),
    ]
    assert events[0].track == events[2].track != events[1].track, "nobody turned round half-way"


def test_scenescape_frame_that_comes_too_late_changes_nothing() -> None:
    size = {"": (2000, 600)}
    lines = [scene(n / 10, [(1, 40 * n)] if 15 <= n < 40 else []) for n in range(70)]
    expected = read(SceneScape(size), lines)
    assert [event.kind for event in expected] == ["entry", "exit"]

    adapter = SceneScape(size)
    events = [event for line in lines[:31] for event in adapter.receive(line)]
    assert refused(adapter, lines[24]) == "out-of-order"
    assert events + read(adapter, lines[31:]) == expected


def test_scenescape_frame_with_a_wrong_time_breaks_no_track() -> None:
    size = {"": (2000, 600)}
    lines = [scene(n / 10, [(1, 40 * n)] if 15 <= n < 40 else []) for n in range(70)]
    expected = read(SceneScape(size), lines)
    assert [event.kind for event in expected] == ["entry", "exit"]

    wrong = scene(3600.0, [(1, 1200)])
    assert read(SceneScape(size), [*lines[:31], wrong, *lines[31:]]) == expected


def test_scenescape_limits_and_refusals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_names, "CAMERAS_MAX", 1)
    monkeypatch.setattr(camera_streams, "TRACKS_MAX", 3)
    adapter = SceneScape({"": (800, 600)}, ["person"])
    person = {"id": 1, "bounding_box": {"x": -0.1, "y": 0.2, "width": 0.1, "height": 0.4}}
    lens = {"id": "cam1", "timestamp": iso(T), "objects": {"person": [person]}}

    assert adapter.receive(b"scenescape/data/camera/cam1 " + scene(0, [(1, 100)])) == []
    for line, reason in (
        (scene(0, [], "cam3"), "too-many-cameras"),
        (json.dumps(lens).encode(), "no-pixels"),
        (scene(0, [(1, 1), (2, 1), (3, 1), (4, 1)]), "too-many"),
        (
            json.dumps({**lens, "objects": {}, "timestamp": "0001-01-01T00:00:00Z"}).encode(),
            "bad-value",
        ),
        (json.dumps({**lens, "timestamp": None}).encode(), "bad-value"),
        (b"scenescape/regulated/scene/1 {}", "other-topic"),
    ):
        assert refused(adapter, line) == reason, line
    assert refused(SceneScape({}), scene(0, [])) == "no-size"


# --- AXIS -----------------------------------------------------------------------------------------


def axis_frame(t: float, *ids: str, x: float = 0.5, channel: int = 1) -> bytes:
    """Return a frame rebuilt from the schema "Frame" (developer.axis.com)."""
    box = {"left": x - 0.05, "top": 0.2, "right": x + 0.05, "bottom": 0.8}
    detections = [{"object_track_id": one, "bounding_box": box} for one in ids]
    frame = {"channel_id": channel, "timestamp": iso(T + t), "detections": detections}
    return json.dumps(frame).encode()


def test_axis_frames_become_passages() -> None:
    change = {"type": "TrackEnded", "object_track_id": "a"}
    ended = json.dumps({"timestamp": iso(T + 4.1), "track_events": [change]}).encode()
    lines = [axis_frame(0), *(axis_frame(2 + n / 4, "a", x=0.1 + n / 20) for n in range(9)), ended]

    assert short(read(Axis("gate"), lines)) == [
        ("gate", "entry", 2.0, 0.1, 0.8, "a"),
        ("gate", "exit", 4.0, 0.5, 0.8, "a"),
    ]


def test_axis_frames_of_the_forerunner() -> None:
    """Rebuilt from the example on Message Broker's page "Standard Topics" (Axis's ACAP API)."""

    def frame(t: float, *operations: dict[str, str], wrapped: bool = False) -> bytes:
        box = {"bottom": 0.89332, "left": 0.13332, "right": 0.80004, "top": 0.59942}
        one = {"track_id": "1", "bounding_box": box, "class": {"type": "Human", "score": 0.6}}
        seen = [one] if t and not operations else []
        frame = {"timestamp": iso(T + t), "observations": seen, "operations": list(operations)}
        return json.dumps({"data": {"frame": frame}} if wrapped else {"frame": frame}).encode()

    gone = {"type": "DeleteOperation", "id": "1"}
    lines = [frame(0), frame(2), frame(2.6, wrapped=True), frame(2.7, gone)]
    assert short(read(Axis("gate"), lines)) == [
        ("gate", "entry", 2.0, 0.4667, 0.8933, "1"),
        ("gate", "exit", 2.6, 0.4667, 0.8933, "1"),
    ]


def test_axis_cameras_are_told_apart_by_topic_and_channel() -> None:
    topics = (b"axis/lobby ", b"axis/hall/com.axis.scene.frame.v1 ")
    lines = [
        topic + axis_frame(n / 4, *("1" * (n > 7)), channel=channel)
        for n in range(12)
        for topic, channel in zip(topics, (1, 2), strict=True)
    ]
    assert [e.camera for e in read(Axis(), lines)] == ["lobby", "hall-2"]


# --- ONVIF ----------------------------------------------------------------------------------------

# Rebuilt from the ONVIF Analytics Service Specification: its example of a frame whose coordinates
# run from (0, 0) at the lower left to (320, 240) at the upper right.
PIXELS = (
    '<tt:Transformation><tt:Translate x="-1.0" y="-1.0"/><tt:Scale x="0.00625" y="0.00834"/>'
    "</tt:Transformation>"
)


def onvif_object(name: int, x: float, kind: str = "Human") -> str:
    return (
        f'<tt:Object ObjectId="{name}"><tt:Appearance><tt:Shape>'
        f'<tt:BoundingBox left="{x - 10}" top="180" right="{x + 10}" bottom="60"/>'
        f'<tt:CenterOfGravity x="{x}" y="120"/></tt:Shape>'
        f'<tt:Class><tt:Type Likelihood="0.8">{kind}</tt:Type></tt:Class>'
        f"</tt:Appearance></tt:Object>"
    )


def onvif_xml(t: float, inside: str = "") -> bytes:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<tt:MetadataStream xmlns:tt="http://www.onvif.org/ver10/schema">\n<tt:VideoAnalytics>\n'
        f'<tt:Frame UtcTime="{iso(T + t)}">{PIXELS}{inside}</tt:Frame>\n'
        f"</tt:VideoAnalytics>\n</tt:MetadataStream>"
    ).encode()


def onvif_json(t: float, *names: int) -> bytes:
    """Return a message in the form of the specification's example of JSON over MQTT."""
    box = {"@left": -0.2, "@top": 0.5, "@right": 0.0, "@bottom": -0.5}
    objects = [{"@ObjectId": name, "Appearance": {"Shape": {"BoundingBox": box}}} for name in names]
    frame = {"@UtcTime": iso(T + t), "@Source": "MyClassifier", "Object": objects}
    message = json.dumps({"Frame": [frame]}).encode()
    return b"MyDevice/onvif-mj/VideoAnalytics/1/MyClassifier " + message


def test_onvif_documents_over_lines_and_on_one_line() -> None:
    documents = [onvif_xml(0)]
    documents += [onvif_xml(2 + n / 4, onvif_object(15, 32 + 32 * n)) for n in range(9)]
    documents.append(onvif_xml(4.1, '<tt:ObjectTree><tt:Delete ObjectId="15"/></tt:ObjectTree>'))
    on_one = b"".join(document.replace(b"\n", b" ") for document in documents)

    for stream in (b"\n".join(documents), on_one):
        lines = [one for _, one in frames([stream], LINE_BYTES_MAX, Onvif.begins)]
        assert short(read(Onvif("gate", ["human"]), lines)) == [
            ("gate", "entry", 2.0, 0.1, 0.7498, "15"),
            ("gate", "exit", 4.0, 0.9, 0.7498, "15"),
        ]


def test_onvif_json_names_the_camera_in_its_topic() -> None:
    lines = [onvif_json(n / 4, *(4,) * (n >= 8)) for n in range(12)] + [onvif_json(9)]
    assert short(read(Onvif(), lines)) == [
        ("MyDevice", "entry", 2.0, 0.45, 0.75, "MyClassifier-4"),
        ("MyDevice", "exit", 2.75, 0.45, 0.75, "MyClassifier-4"),
    ]
    assert refused(Onvif(), b"MyDevice/onvif-ej/RuleEngine {}") == "other-topic"


def test_onvif_hostile_xml_is_refused_and_what_follows_is_read() -> None:
    bomb = (
        b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><MetadataStream>&b;</MetadataStream>'
    )
    adapter = Onvif("gate")
    assert refused(adapter, bomb) == "doctype"
    assert refused(adapter, b"<MetadataStream><a></MetadataStream>") == "malformed"
    hidden = bomb.decode().replace("<?xml version", "<?xml encoding='utf-16' version")
    assert refused(adapter, hidden.encode("utf-16")) in ("malformed", "doctype")

    good = [onvif_xml(0), *(onvif_xml(2 + n, onvif_object(1, 50)) for n in range(3))]
    stream = [b"<a/></MetadataStream>", *good]
    cut, *rest = [one for _, one in frames(stream, LINE_BYTES_MAX, Onvif.begins)]
    assert refused(adapter, cut) == "malformed"
    assert [e.kind for e in read(adapter, rest)] == ["entry"]


# --- DeepStream -----------------------------------------------------------------------------------


def minimal(t: float, *objects: str, sensor: str = "lobby") -> bytes:
    """Return a message rebuilt from the minimal schema (page "Gst-nvmsgconv" of DeepStream)."""
    message = {"@timestamp": iso(T + t), "sensorId": sensor, "objects": list(objects)}
    return json.dumps({"version": "4.0", "id": "252", **message}).encode()


def full(t: float, name: str, left: float) -> bytes:
    """Return a message rebuilt from the full schema (page "Gst-nvmsgconv" of DeepStream)."""
    box = {"topleftx": left, "toplefty": 215, "bottomrightx": left + 192, "bottomrighty": 540}
    message = {
        "mdsversion": "1.0",
        "@timestamp": iso(T + t),
        "place": {"id": "1", "name": "XYZ", "type": "garage"},
        "sensor": {"id": "lobby", "type": "Camera", "description": "Entrance"},
        "object": {"id": name, "person": {"age": 45}, "bbox": box, "speed": 0},
    }
    return json.dumps(message).encode()


def deepstream(labels: tuple[str, ...] = ()) -> DeepStream:
    return DeepStream({"": (1920, 1080)}, None, labels)


def test_deepstream_both_schemas() -> None:
    plate = "540|Person|#|sedan|M|CA 444|0.8"
    lefts = [96 * (1 + n) for n in range(9)]
    short_form = [minimal(0), minimal(1, "1|2|3|4|5", sensor="hall")]
    short_form += [
        minimal(2 + n / 4, f"957|{left}|150|{left + 192}|{plate}", f"{2**64 - 1}|0|0|9|9|Person")
        for n, left in enumerate(lefts)
    ]
    long_form = [full(0, "1", 96), *(full(2 + n / 4, "957", left) for n, left in enumerate(lefts))]

    for lines in ([*short_form, minimal(9)], [*long_form, full(9, "1", 96)]):
        assert read(deepstream(("vehicle",)), lines) == []
        for labels in ((), ("person",)):
            assert short(read(deepstream(labels), lines)) == [
                ("lobby", "entry", 2.0, 0.1, 0.5, "957"),
                ("lobby", "exit", 4.0, 0.5, 0.5, "957"),
            ]


def test_a_camera_that_falls_silent_has_nobody_in_view() -> None:
    """DeepStream sends nothing of an empty view: its last exit does not wait for the next object."""
    adapter = deepstream()
    events = adapter.receive(minimal(0))
    for n in range(8):
        assert adapter.silent(100 + n / 4) == []
        events += adapter.receive(minimal(2 + n / 4, "957|96|150|288|540|Person"))

    assert adapter.silent(103.9) == []
    events += adapter.silent(104.5)
    assert [(e.kind, e.t - T) for e in events] == [("entry", 2.0), ("exit", 3.75)]
    assert adapter.silent(200.0) == adapter.close() == []


def test_times_are_iso_8601_or_seconds_or_milliseconds() -> None:
    assert seconds_of(1_700_000_000_250) == T + 0.25
    assert seconds_of(1_700_000_000.25) == T + 0.25
    assert seconds_of("2023-11-14T22:13:20.250") == T + 0.25
    assert seconds_of("2023-11-14 22:13:20.250 UTC") == T + 0.25
    assert seconds_of("2023-11-14T23:13:20.250+01:00") == T + 0.25


# --- all ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("adapter", "line", "reason"),
    [
        (Mot("a", {"a": (9, 9)}, 10, 0.0), b"1,2,3", "malformed"),
        (Mot("a", {"a": (9, 9)}, 10, 0.0), b"frame,id,left,top,width,height", "malformed"),
        (Mot("a", {"a": (9, 9)}, 10, 0.0), b"1,2,3,4,-5,6,1", "bad-value"),
        (Mot("a", {"a": (9, 9)}, 10, 0.0), b"1e300,2,3,4,5,6,1", "bad-value"),
        (Axis("gate"), b"{}", "malformed"),
        (Axis("gate"), b"nonsense", "malformed"),
        (Axis("gate"), b'{"timestamp": "yesterday", "observations": []}', "bad-value"),
        (Axis("gate"), b'{"timestamp": "4000-01-01T00:00:00Z", "operations": []}', "bad-value"),
        (Axis(), axis_frame(0), "no-camera"),
        (deepstream(), minimal(0, "1|2|3"), "malformed"),
        (deepstream(), minimal(0, "1|2|3|4|wide"), "malformed"),
        (deepstream(), minimal(0, sensor="a#b"), "no-camera"),
        (deepstream(), b'{"@timestamp": 1700000000000, "sensorId": 3}', "malformed"),
        (deepstream(), b'{"@timestamp": 1e300, "sensorId": 3, "objects": []}', "bad-value"),
        (deepstream(), b'{"@timestamp": 0, "sensorId": 0, "object": {"id": 1}}', "no-box"),
    ],
)
def test_lines_that_make_no_sense_are_refused(adapter: Adapter, line: bytes, reason: str) -> None:
    assert refused(adapter, line) == reason


NAMES = """
    frame data timestamp detections observations track_events operations type object_track_id id
    track_id bounding_box left top right bottom class path channel_id Frame @UtcTime Object
    @ObjectId Appearance Shape BoundingBox @left Transformation Scale @x sensorId sensor objects
    object bbox topleftx @timestamp"""
KEYS = st.sampled_from(NAMES.split())
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9)
LEAVES |= st.sampled_from([iso(T), iso(T + 1), "1|2|3|4|5|Person", "nan|nan|nan|nan|nan"])
JSON = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=5)
)


@settings(max_examples=40, deadline=None)
@given(messages=st.lists(JSON, max_size=4), lines=st.lists(st.binary(max_size=80), max_size=4))
def test_anything_is_read_or_rejected(messages: Any, lines: list[bytes]) -> None:
    survived([*(json.dumps(message).encode() for message in messages), *lines])


@settings(max_examples=40, deadline=None)
@given(cut=st.integers(0, 900), put=st.binary(max_size=8))
def test_damaged_messages_are_read_or_rejected(cut: int, put: bytes) -> None:
    for whole in (onvif_xml(1, onvif_object(3, 50)), *says.passage()):
        survived([whole[:cut] + put + whole[cut:], whole[cut:], whole])


WEIRD = [None, True, -1, 10**400, 1e308, float("nan"), "", "a" * 64, "\0", "9" * 5000, [], {}, [[]]]
"""Values that no program sends in its right mind, in the place of others."""


def mutations(message: bytes, count: int) -> Iterator[bytes]:
    """Yield copies of a message with an odd value somewhere, or with damaged bytes."""
    chance = random.Random(7)
    topic, brace, text = message.partition(b"{")
    for n in range(count):
        if n % 2 and brace:
            changed = json.loads(brace + text)
            inside: Any = changed
            while isinstance(inside, dict | list) and inside:
                around, places = (
                    inside,
                    [*(inside if isinstance(inside, dict) else range(len(inside)))],
                )
                place = chance.choice(places)
                inside = inside[place]
                if chance.random() < 0.3:
                    break
            around[place] = chance.choice(WEIRD)
            yield topic + json.dumps(changed).encode()
        else:
            at = chance.randrange(len(message))
            odd = str(chance.choice(WEIRD)).encode() + chance.randbytes(1)
            yield message[:at] + odd + message[at + chance.randrange(6) :]


def test_no_message_ends_the_reading(capsys: pytest.CaptureFixture[str]) -> None:
    """Each format's messages, changed at some place, are thrown at each adapter; and a good one."""
    good = [*says.passage(), *mot_lines()[:1], scene(1, [(1, 50)]), axis_frame(1, "a")]
    good += [onvif_xml(1, onvif_object(3, 50)), onvif_json(1, 4), full(1, "1", 96)]
    good.append(minimal(1, "957|96|150|288|540|Person"))
    lines = [line for message in good for line in mutations(message, 40)]
    for name, one in FORMATS.items():
        if one.make is None:
            continue
        reader = LineReader()
        given = [*lines, *(line for line in good for _ in "12")]
        events = [*reader.adapted(name, enumerate(given), one.make(OPTIONS))]
        assert reader.lines_read == len(given)
        assert all(isinstance(event, Event) for event in events)
        assert reader.rejections.total() < len(given)
        assert "unreadable" not in reader.rejections, name


def survived(lines: list[bytes]) -> None:
    """Let every format read lines, of which it may reject some."""
    for one in FORMATS.values():
        if one.make is None:
            continue
        adapter = one.make(OPTIONS)
        for line in lines:
            with contextlib.suppress(Rejected):
                assert all(isinstance(event, Event) for event in adapter.receive(line))
        adapter.close()


# --- Labels ---------------------------------------------------------------------------------------


def labels_of(adapter: Adapter, lines: list[bytes]) -> list[tuple[str, str | None]]:
    return [(event.kind, event.label) for event in read(adapter, lines)]


def test_events_have_the_class_as_label_and_nothing_else() -> None:
    """Not the face that Frigate knows, nor the plate of DeepStream's car."""
    both = [("entry", "person"), ("exit", "person")]
    plate = "540|Person|#|sedan|M|CA 444|0.8"
    passing = [96 * (1 + n) for n in range(9)]
    deep = [minimal(2 + n / 4, f"957|{x}|150|{x + 192}|{plate}") for n, x in enumerate(passing)]
    walk = [scene(n / 10, [(41, 8 * (n - 15))] if 15 <= n < 90 else []) for n in range(130)]
    human = [
        json.dumps(json.loads(line) | {"detections": seen}).encode()
        for line in [axis_frame(2 + n / 4, "a", x=0.1 + n / 20) for n in range(9)]
        for seen in [[one | {"class": {"type": "Human"}} for one in json.loads(line)["detections"]]]
    ]
    onvif = [onvif_xml(2 + n / 4, onvif_object(15, 32 + 32 * n)) for n in range(9)]

    assert labels_of(Frigate(SIZES), says.passage(t=T)) == both
    assert labels_of(deepstream(), [minimal(0), *deep, minimal(9)]) == both
    assert labels_of(SceneScape({"cam1": (800, 600)}, is_tracked=False), walk) == both
    people = [("entry", "human"), ("exit", "human")]
    assert labels_of(Axis("gate"), [axis_frame(0), *human, axis_frame(9)]) == people
    assert labels_of(Onvif("gate"), [onvif_xml(0), *onvif, onvif_xml(9)]) == people
    assert labels_of(Mot("gate", {"": (1920, 1080)}, 10, T), mot_lines())[:1] == [("entry", None)]
