"""Analytics of cameras and boxes become events: AXIS scene metadata, ONVIF Profile M, DeepStream.

Where messages are from is said beside them.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

import frigate_messages as says
import pytest
from hypothesis import given, settings, strategies as st

from camtopod.adapt import FORMATS, FormatOptions, camera_streams
from camtopod.adapt.adapter import Adapter
from camtopod.adapt.axis import Axis
from camtopod.adapt.camera_streams import seconds_of
from camtopod.adapt.deepstream import DeepStream
from camtopod.adapt.onvif import Onvif
from camtopod.codec import Rejected
from camtopod.records import Event

T = 1_700_000_000.0
OPTIONS = FormatOptions(size={"": (1920, 1080)}, camera="gate", fps=10.0)


def every_adapter() -> list[Adapter]:
    return [one.make(OPTIONS) for one in FORMATS.values() if one.make is not None]


def iso(t: float) -> str:
    return datetime.fromtimestamp(t, UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def read(reader: Adapter, lines: list[bytes]) -> list[Event]:
    return [event for line in lines for event in reader.receive(line)] + reader.close()


def short(events: list[Event]) -> list[tuple[Any, ...]]:
    return [(e.camera, e.kind, round(e.t - T, 3), e.x, e.y, e.track) for e in events]


def refused(reader: Adapter, line: bytes) -> str:
    with pytest.raises(Rejected) as caught:
        reader.receive(line)
    return caught.value.reason


# --- AXIS -----------------------------------------------------------------------------------------


def axis_frame(t: float, *ids: str, x: float = 0.5, channel: int = 1, **more: Any) -> bytes:
    """Return a frame rebuilt from the schema "Frame" (developer.axis.com)."""
    box = {"left": x - 0.05, "top": 0.2, "right": x + 0.05, "bottom": 0.8}
    detections = [{"object_track_id": one, "bounding_box": box, **more} for one in ids]
    frame = {"channel_id": channel, "timestamp": iso(T + t), "detections": detections}
    return json.dumps(frame).encode()


def axis_ended(t: float, name: str) -> bytes:
    events = [{"type": "TrackEnded", "object_track_id": name}]
    frame = {"channel_id": 1, "timestamp": iso(T + t), "track_events": events}
    return json.dumps(frame).encode()


def axis_track(start: float, end: float, name: str = "a-1", kind: str = "Human") -> bytes:
    """Return a track rebuilt from the schema "Object Track" (developer.axis.com)."""
    path = [
        {
            "timestamp": iso(T + start),
            "bounding_box": {"left": 0.0, "top": 0.2, "right": 0.2, "bottom": 0.5},
        },
        {
            "timestamp": iso(T + end),
            "bounding_box": {"left": 0.7, "top": 0.2, "right": 0.9, "bottom": 0.6},
        },
    ]
    classes = [{"type": kind, "score": 0.9}, {"type": "Car", "score": 0.1}]
    return json.dumps({"id": name, "channel_id": 1, "classes": classes, "path": path}).encode()


def test_axis_frames_say_who_comes_and_goes() -> None:
    lines = [axis_frame(0), *(axis_frame(2 + n / 4, "a", x=0.1 + n / 20) for n in range(9))]
    events = read(Axis("gate"), [*lines, axis_ended(4.1, "a")])
    assert short(events) == [
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


def test_axis_tracks_give_both_events_once() -> None:
    reader = Axis()
    line = b"axis/lobby/com.axis.scene.object_track.v1 " + axis_track(1, 9)
    assert short(reader.receive(line)) == [
        ("lobby", "entry", 1.0, 0.1, 0.5, "a-1"),
        ("lobby", "exit", 9.0, 0.8, 0.6, "a-1"),
    ]
    assert reader.receive(line) == []
    assert reader.receive(b"axis/lobby " + axis_track(1, 1.2, "short")) == []


def test_axis_frames_and_tracks_of_one_camera_would_count_twice() -> None:
    reader = Axis("gate")
    reader.receive(axis_frame(0))
    assert refused(reader, axis_track(1, 9)) == "two-sources"


def test_axis_cameras_are_told_apart_by_topic_and_channel() -> None:
    reader = Axis()
    for n in range(8):
        for camera in (b"axis/lobby ", b"axis/hall/com.axis.scene.frame.v1 "):
            reader.receive(camera + axis_frame(n / 4))
    events = []
    for n in range(8, 12):
        events += reader.receive(b"axis/lobby " + axis_frame(n / 4, "1"))
        events += reader.receive(b"axis/hall/com.axis.scene.frame.v1 " + axis_frame(n / 4, "1"))
    assert [e.camera for e in events] == ["lobby", "hall"]
    one = Axis("gate")
    lines = [axis_frame(n / 4, *("7" * (n > 5)), channel=2) for n in range(20)]
    assert [e.camera for e in read(one, lines)] == ["gate-2"]
    assert refused(Axis(), axis_frame(0)) == "no-camera"


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"{}", "malformed"),
        (b"nonsense", "malformed"),
        (b'{"id": "a", "path": []}', "no-box"),
        (b'{"timestamp": "yesterday"}', "bad-value"),
        (b'{"timestamp": "4000-01-01T00:00:00Z"}', "bad-value"),
    ],
)
def test_axis_refusals(line: bytes, reason: str) -> None:
    assert refused(Axis("gate"), line) == reason


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


def onvif_xml(t: float, inside: str = "", more: str = "") -> bytes:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<tt:MetadataStream xmlns:tt="http://www.onvif.org/ver10/schema">\n<tt:VideoAnalytics>\n'
        f'<tt:Frame UtcTime="{iso(T + t)}"{more}>{PIXELS}{inside}</tt:Frame>\n'
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
    gone = '<tt:ObjectTree><tt:Delete ObjectId="15"/></tt:ObjectTree>'
    documents.append(onvif_xml(4.1, gone))
    wanted = [
        ("gate", "entry", 2.0, 0.1, 0.7498, "15"),
        ("gate", "exit", 4.0, 0.9, 0.7498, "15"),
    ]
    over_lines = [line for document in documents for line in document.splitlines()]
    assert short(read(Onvif("gate"), over_lines)) == wanted
    on_one = b"".join(document.replace(b"\n", b" ") for document in documents)
    assert short(read(Onvif("gate"), [on_one])) == wanted


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
    reader = Onvif("gate")
    assert refused(reader, bomb) == "doctype"
    assert refused(reader, b"<MetadataStream><a></MetadataStream>") == "malformed"
    hidden = bomb.decode().replace("<?xml version", "<?xml encoding='utf-16' version")
    assert refused(reader, hidden.encode("utf-16")) in ("malformed", "doctype")
    good = [onvif_xml(0), *(onvif_xml(2 + n, onvif_object(1, 50)) for n in range(3))]
    assert refused(reader, b"<a/></MetadataStream>" + good[0]) == "malformed"
    assert [e.kind for e in read(reader, good[1:])] == ["entry"]


# --- DeepStream -----------------------------------------------------------------------------------


def minimal(t: float, *objects: str, sensor: str = "lobby") -> bytes:
    """Return a message rebuilt from the minimal schema (page "Gst-nvmsgconv" of DeepStream)."""
    message = {
        "version": "4.0",
        "id": "252",
        "@timestamp": iso(T + t),
        "sensorId": sensor,
        "objects": list(objects),
    }
    return json.dumps(message).encode()


def full(t: float, name: str, left: float, sensor: str = "lobby") -> bytes:
    """Return a message rebuilt from the full schema (page "Gst-nvmsgconv" of DeepStream)."""
    box = {
        "topleftx": left,
        "toplefty": 215,
        "bottomrightx": left + 192,
        "bottomrighty": 540,
    }
    message = {
        "messageid": "84a3a0ad-7eb8-49a2-9aa7-104ded6764d0",
        "mdsversion": "1.0",
        "@timestamp": iso(T + t),
        "place": {"id": "1", "name": "XYZ", "type": "garage"},
        "sensor": {"id": sensor, "type": "Camera", "description": "Entrance"},
        "object": {"id": name, "person": {"age": 45}, "bbox": box, "speed": 0},
        "event": {"id": "e", "type": "moving"},
        "videoPath": "",
    }
    return json.dumps(message).encode()


def deepstream(camera: str | None = None, labels: tuple[str, ...] = ()) -> DeepStream:
    return DeepStream({"": (1920, 1080)}, camera, labels)


WANTED = [
    ("lobby", "entry", 2.0, 0.1, 0.5, "957"),
    ("lobby", "exit", 4.0, 0.5, 0.5, "957"),
]


def test_deepstream_minimal() -> None:
    lines = [minimal(0)]
    for n in range(9):
        left = 96 * (1 + n)
        plate = "Person|#|sedan|M|CA 444|0.8"
        lines.append(minimal(2 + n / 4, f"957|{left}|150|{left + 192}|540|{plate}"))
    lines += [minimal(3, "1|2|3|4|5", sensor="hall"), minimal(9)]
    assert short(read(deepstream(), lines)) == WANTED
    assert short(read(deepstream(labels=("person",)), lines)) == WANTED
    assert read(deepstream(labels=("vehicle",)), lines) == []


def test_deepstream_full() -> None:
    lines = [full(0, "1", 96), *(full(2 + n / 4, "957", 96 * (1 + n)) for n in range(9))]
    lines.append(full(9, "1", 96))
    assert short(read(deepstream(), lines)) == WANTED
    assert short(read(deepstream(labels=("Person",)), lines)) == WANTED


def test_deepstream_untracked_objects_are_no_tracks() -> None:
    lines = [minimal(0)]
    lines += [minimal(2 + n / 4, f"{2**64 - 1}|0|0|9|9|Person") for n in range(9)]
    assert read(deepstream(), lines) == []


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (minimal(0, "1|2|3"), "malformed"),
        (minimal(0, "1|2|3|4|wide"), "malformed"),
        (minimal(0, sensor="a b"), "no-camera"),
        (b'{"@timestamp": 1700000000000, "sensorId": 3}', "malformed"),
        (b'{"@timestamp": 1e300, "sensorId": 3, "objects": []}', "bad-value"),
        (b'{"sensorId": "x", "objects": []}', "bad-value"),
        (b'{"@timestamp": 0, "sensorId": 3, "object": {"id": 1}}', "no-box"),
        (minimal(0, *["1|2|3|4|5"] * 1001), "too-many"),
    ],
)
def test_deepstream_refusals(line: bytes, reason: str) -> None:
    assert refused(deepstream(), line) == reason


def test_deepstream_needs_the_size_and_takes_milliseconds() -> None:
    assert refused(DeepStream({}), minimal(0)) == "no-size"
    assert seconds_of(1_700_000_000_250) == T + 0.25
    assert seconds_of("2023-11-14T22:13:20.250") == T + 0.25
    assert seconds_of("2023-11-14T23:13:20.250+01:00") == T + 0.25


def test_a_camera_that_falls_silent_has_nobody_in_view() -> None:
    """DeepStream sends nothing of an empty view: its last exit does not wait for the next object."""
    reader = deepstream()
    events = reader.receive(minimal(0))
    for n in range(8):
        assert reader.silent(100 + n / 4) == []
        events += reader.receive(minimal(2 + n / 4, "957|96|150|288|540|Person"))
    assert reader.silent(103.9) == []
    events += reader.silent(104.5)
    assert [(e.kind, e.t - T) for e in events] == [("entry", 2.0), ("exit", 3.75)]
    assert reader.silent(200.0) == reader.close() == []


def test_cameras_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_streams, "STREAMS_MAX", 3)
    reader = deepstream()
    for n in range(3):
        reader.receive(minimal(0, sensor=f"c{n}"))
    assert refused(reader, minimal(0, sensor="c3")) == "too-many-cameras"


# --- Anything -------------------------------------------------------------------------------------

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


def survived(lines: list[bytes]) -> None:
    """Let every format read lines, of which it may reject some."""
    for reader in every_adapter():
        for line in lines:
            try:
                events = reader.receive(line)
            except Rejected:
                continue
            assert all(isinstance(event, Event) for event in events)
        reader.close()
