"""Messages in a stream: where they end, whatever the pieces it comes in, and at what cost."""

from __future__ import annotations

import json
import time

import pytest

from camtopod.adapt import frames

MESSAGES = [{"a": n, "b": {"c": [1, {"d": 'x{"}\\'}, {}, []]}, "e": "\u00e9\n"} for n in range(3)]


def found(
    stream: bytes, piece: int = 1 << 16, most: int = 1 << 20, begins: bytes = b"{"
) -> list[bytes]:
    pieces = (stream[at : at + piece] for at in range(0, len(stream), piece))
    return [message for _, message in frames(pieces, most, begins)]


@pytest.mark.parametrize("piece", [1, 2, 7, 1000])
def test_pieces_make_no_difference(piece: int) -> None:
    whole = [json.dumps(one, indent=1).encode() for one in MESSAGES]
    assert found(b"\xef\xbb\xbf" + b"\r\n".join(whole), piece) == whole
    topics = [b"site/a " + one for one in whole]
    assert found(b"\n".join(topics), piece) == topics
    documents = [b"<?xml?><t:MetadataStream>\n</t:MetadataStream>", b"<MetadataStream\na='/'/>"]
    for between in (b"", b"\0", b" \n\n", b"\xef\xbb\xbf"):
        assert found(between.join(documents * 2), piece, begins=b"<{") == documents * 2
    cut = b"<?xml?><MetadataStream><a>"
    assert found(cut + documents[0] + cut + b"x\n{}", piece, begins=b"<{")[:2] == [
        cut,
        documents[0],
    ]


def test_a_message_that_was_cut_off_within_an_array_ends_where_the_next_begins() -> None:
    whole = [json.dumps(one, indent=2).encode() for one in MESSAGES]
    cut = whole[0][: whole[0].index(b"1,")]
    for end in (b" 1", b' "x', b" {}"):
        assert found(cut + end + b"\n" + b"\n".join(whole)) == [cut + end, *whole]


def test_a_format_of_lines_has_lines_alone() -> None:
    rows = [b"# {fps: 30", b"1,2,3", b"<4>,5", b'6,"7']
    assert found(b"\r".join(rows), piece=3, begins=b"") == rows


def test_what_is_too_long_is_cut_and_what_follows_is_read() -> None:
    for stream in (b"x" * 500, b'{"a": "' + b"x" * 500 + b'"}', b"[" + b'{"a":[' + b"1," * 300):
        for piece in (1, 64, 1000):
            long, *rest = found(stream + b'\n{"b": 1}\n', piece, most=100)
            assert len(long) == 101
            assert rest == [b'{"b": 1}']


@pytest.mark.parametrize("piece", [1, 64, 1 << 16])
def test_what_is_in_a_message_that_is_too_long_is_read_after_the_limit(piece: int) -> None:
    stream = b'{"a": [\n' + b'  {"b": 1},\n' * 50
    assert found(stream, piece, most=100).count(b'{"b": 1}') == 42


@pytest.mark.parametrize(
    ("head", "unit"),
    [
        (b'{"', b'\\"'),
        (b"{", b'{"a":\n'),
        (b"", b"{}"),
        (b"a", b"a{\n"),
        (b"<a>\n", b"x\n"),
        (b"<MetadataStream ", b"x\n"),
        (b"<a", b"<>"),
        (b"<", b"<?xml>"),
    ],
)
def test_time_grows_with_length_alone(head: bytes, unit: bytes) -> None:
    """Four times as much of what is made to be slow takes four times as long, not sixteen times."""

    def seconds(count: int) -> float:
        began = time.process_time()
        found(head + unit * count, piece=512, begins=b"<{")
        return time.process_time() - began

    count = 1 << 10
    while (once := seconds(count)) < 0.01:
        count *= 2
    assert seconds(4 * count) < 9 * once + 0.02
