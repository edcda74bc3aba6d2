"""Decoding: any bytes give a record, or `Rejected` with a reason."""

from __future__ import annotations

import subprocess
import sys

import msgspec
import pytest
from hypothesis import example, given, strategies as st
from synthetic_topology import synthetic_topology

from camtopod.codec import (
    EVENT_BYTES_MAX,
    T_MAX,
    T_MIN,
    Rejected,
    decode_topology,
    event_from_json,
    event_from_msgpack,
    read,
    to_json,
    to_msgpack,
)
from camtopod.records import RESERVED, Event, Lacks, NextCamera, Prediction

GOOD = {"camera": "lobby", "kind": "entry", "t": 1700000000.25, "x": 0.31, "y": 0.88, "track": "17"}
NUMBERS = st.floats(0, 1)
EVENTS = st.builds(
    Event,
    st.from_regex(r"[A-Za-z0-9_.-]{1,64}", fullmatch=True).filter(lambda id_: id_ not in RESERVED),
    st.sampled_from(["entry", "exit"]),
    st.floats(T_MIN, T_MAX, exclude_max=True),
    track=st.none() | st.text(max_size=20),
    clock_sd=st.none() | st.floats(0, 1e6),
)


def reason(**change: object) -> str:
    """Return why the valid event with these changes is refused, in both encodings."""
    fields = {name: value for name, value in (GOOD | change).items() if value is not ...}
    with pytest.raises(Rejected) as caught:
        event_from_json(msgspec.json.encode(fields))
    with pytest.raises(Rejected) as packed:
        event_from_msgpack(msgspec.msgpack.encode(fields))
    assert caught.value.reason == packed.value.reason
    return caught.value.reason


@given(
    EVENTS,
    st.none() | st.tuples(NUMBERS, NUMBERS),
    st.none() | st.tuples(st.text(max_size=9), st.integers(0, 2**63 - 1)),
)
def test_events_come_back(
    event: Event, place: tuple[float, float] | None, count: tuple[str, int] | None
) -> None:
    x, y = place or (None, None)
    boot, seq = count or (None, None)
    event = msgspec.structs.replace(event, x=x, y=y, boot=boot, seq=seq)

    assert event_from_json(to_json(event)) == event
    assert event_from_json(to_json(event).decode()) == event
    assert event_from_msgpack(to_msgpack(event)) == event
    assert b"\n" not in to_json(event)


def test_the_example_of_the_contract() -> None:
    line = '{"camera":"lobby","kind":"entry","t":1700000000.25,"x":0.31,"y":0.88,"track":"17","boot":"5f1c","seq":1041}'
    assert event_from_json(line) == Event(
        "lobby", "entry", 1700000000.25, 0.31, 0.88, "17", "5f1c", 1041
    )
    assert to_json(event_from_json(line)).decode() == line


def test_more_fields_and_numbered_tracks_are_welcome() -> None:
    event = event_from_json(msgspec.json.encode(GOOD | {"track": 17, "colour": {"shirt": ["red"]}}))
    assert event.track == "17"
    assert event_from_json(b'{"camera":"a","kind":"exit","t":5}') == Event("a", "exit", 5.0)


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("t", ["late", None, ..., 1e12, -1e12, T_MAX, T_MIN - 1, [], True]),
        ("camera", ["", "daemon", ".", "..", "a b", "a/b", "a" * 65, "a\n", "ä", 5, None, ...]),
    ],
)
def test_time_and_camera_must_be_one(field: str, values: list[object]) -> None:
    assert {reason(**{field: value}) for value in values} == {"bad-value"}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"kind": "Entry"}, "bad-value"),
        ({"kind": ...}, "bad-value"),
        ({"x": 1.01}, "bad-value"),
        ({"y": -0.01}, "bad-value"),
        ({"x": None}, "half-position"),
        ({"y": ...}, "half-position"),
        ({"boot": "b"}, "half-sequence"),
        ({"seq": 1}, "half-sequence"),
        ({"boot": "b", "seq": -1}, "bad-value"),
        ({"boot": "b", "seq": 1.5}, "bad-value"),
        ({"boot": "b" * 65, "seq": 1}, "bad-value"),
        ({"track": "t" * 129}, "bad-value"),
        ({"track": [1]}, "bad-value"),
        ({"clock_sd": -1}, "bad-value"),
        ({"more": "m" * EVENT_BYTES_MAX}, "too-long"),
    ],
)
def test_what_does_not_fit_has_a_reason(change: dict[str, object], expected: str) -> None:
    assert reason(**change) == expected


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (b"", "malformed"),
        (b"{", "malformed"),
        (b'{"camera":"a","kind":"exit","t":1}x', "malformed"),
        (b'{"camera":"a","kind":"exit","t":NaN}', "malformed"),
        (b'{"camera":"a","kind":"exit","t":1e999}', "bad-value"),
        (b"[]", "bad-value"),
        (b"null", "bad-value"),
        (b'{"camera":"a","kind":"exit","t":1,"track":' + b"9" * 129 + b"}", "bad-value"),
        (b'{"camera":"a","kind":"exit","t":1,"boot":"b","seq":9223372036854775808}', "bad-value"),
        (b'{"camera":"a","kind":"exit","t":1,"boot":"b","seq":' + b"9" * 4000 + b"}", "bad-value"),
        (b'{"camera":"a","kind":"exit","t":1,"more":"\\ud800"}', "malformed"),
        (b'{"camera":"a","kind":"exit","t":1,"track":"\xff"}', "not-utf8"),
    ],
)
def test_lines_that_are_no_event(line: bytes, expected: str) -> None:
    with pytest.raises(Rejected) as caught:
        event_from_json(line)
    assert caught.value.reason == expected


@pytest.mark.parametrize(
    ("pack", "start", "opening"),
    [(False, b'{"more":', b"["), (True, b"\x81\xa4more", b"\x91")],
    ids=["json", "pack"],
)
def test_what_is_nested_without_end_is_too_deep(pack: bool, start: bytes, opening: bytes) -> None:
    with pytest.raises(Rejected) as caught:
        read(Lacks, start + opening * 1_000_000, pack)
    assert caught.value.reason == "too-deep"


@example(b"\x9f" * 4000)
@given(st.binary(max_size=200))
def test_any_bytes(raw: bytes) -> None:
    for decode in (event_from_json, event_from_msgpack):
        try:
            assert isinstance(decode(raw), Event)
        except Rejected as error:
            assert error.reason  # noqa: PT017


def test_other_nouns() -> None:
    prediction = Prediction(
        "a", "a/1", 5.0, None, 3, 0.25, [NextCamera("b", "b/1", 0.75, 1.0, 2.0, 3.0)]
    )

    assert b'"next":[{"camera":"b"' in to_json(prediction)
    assert read(Prediction, to_json(prediction)) == prediction
    assert read(Prediction, to_msgpack(prediction), pack=True) == prediction
    with pytest.raises(Rejected, match="Expected"):
        read(Prediction, b'{"camera":5}')
    with pytest.raises(Rejected) as caught:
        read(Prediction, b"\xc1", pack=True)
    assert caught.value.reason == "malformed"


def test_a_topology_in_messagepack_is_the_same_and_a_damaged_one_is_rejected() -> None:
    site = synthetic_topology(4)
    packed = to_msgpack(site)

    assert decode_topology(to_json(site)) == site
    assert decode_topology(packed, pack=True) == site
    for spoiled in (packed[:-1], packed[: len(packed) // 2], packed.replace(b"zones", b"zonen")):
        with pytest.raises(Rejected):
            decode_topology(spoiled, pack=True)


MANY_THREADS = """
import sys, threading
from typing import Annotated
import msgspec
from camtopod import codec

sys.setswitchinterval(1e-6)
raw = msgspec.msgpack.encode({"camera": "a", "events": [(1, b"x")] * 50})
for most in range(200, 300):
    text, data = (Annotated[t, msgspec.Meta(max_length=most)] for t in (str, bytes))
    kind = msgspec.defstruct("Kind", [("camera", text), ("events", list[tuple[int, data]])])
    begin = threading.Barrier(6)

    def read():
        begin.wait()
        codec.read(kind, raw, pack=True)

    threads = [threading.Thread(target=read) for _ in range(6)]
    for step in ("start", "join"):
        for thread in threads:
            getattr(thread, step)()
"""


def test_a_type_may_be_decoded_first_by_many_threads_at_once() -> None:
    """Msgspec alone crashes the process here."""
    done = subprocess.run([sys.executable, "-c", MANY_THREADS], check=False, timeout=60)

    assert done.returncode == 0


@pytest.mark.parametrize(
    ("label", "read_as"),
    [
        ("person", "person"),
        ("License_Plate", "licenseplate"),
        ("x" * 64, "x" * 64),
        (None, None),
        ("x" * 65, None),
        (" - ", None),
        (7, None),
        (["person"], None),
        ({"a": {"b": 1}}, None),
    ],
)
def test_a_label_is_read_plainly_or_left_out(label: object, read_as: str | None) -> None:
    """An invalid one is told, and the event stays."""
    fields = GOOD | {"label": label}
    told: list[Rejected] = []

    events = [
        event_from_json(msgspec.json.encode(fields), told.append),
        event_from_msgpack(msgspec.msgpack.encode(fields), told.append),
    ]

    good = event_from_json(msgspec.json.encode(GOOD))
    assert events == [msgspec.structs.replace(good, label=read_as)] * 2
    is_valid = label is None or read_as is not None
    assert [one.reason for one in told] == ([] if is_valid else ["bad-label"] * 2)


def test_an_event_with_another_mistake_beside_its_label_is_refused() -> None:
    assert reason(label=7, t="now") == "bad-value"
    assert reason(label=7, boot="b") == "half-sequence"
