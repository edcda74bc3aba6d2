"""Damaged messages: valid ones with bits, bytes and pieces changed."""

from __future__ import annotations

import random
from collections.abc import Callable

import msgspec

from camtopod.codec import to_json, to_msgpack
from camtopod.records import Event

WILD = (
    *(
        b"\x00",
        b"\xff",
        b"\xc1",
        b"\xc0",
        b"\x80",
        b"\xdf\xff\xff\xff\xff",
        b"\xdd\x00\x0f\xff\xff",
        b"\x9f" * 50,
    ),
    *(
        b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00",
        b"\xcb\x7f\xf0\x00\x00\x00\x00\x00\x00",
        b"\xcf" + b"\xff" * 8,
    ),
    *(
        b"1e999",
        b"-1",
        b"9" * 30,
        b"NaN",
        b"null",
        b'"',
        b"{",
        b"}",
        b"[" * 50,
        b"\\ud800",
        b"\xed\xa0\x80",
        b"\x00\x00",
    ),
)
"""Byte strings that are inserted."""


def seeds(camera: str, boot: str = "b1") -> list[bytes]:
    """Return valid events of a camera in both encodings."""
    t = 1_700_000_000.25
    events = [
        Event(camera, "entry", t),
        Event(camera, "exit", t, 0.31, 0.88, "17", boot, 1041, 0.02),
        Event(camera, "entry", t, 0.0, 1.0, "x" * 40, boot, 2**40),
        Event(camera, "exit", -1.5, 0.5, 0.5, "ü", "", 0),
    ]
    more = {
        "camera": camera,
        "kind": "exit",
        "t": t,
        "more": {"deep": [[[{"a": [1, None, "é"]}]]], "n": 2**60},
    }
    return [
        *map(to_json, events),
        *map(to_msgpack, events),
        to_json(more),
        to_msgpack(more),
        msgspec.msgpack.encode([more]),
    ]


def mutant(chance: random.Random, good: list[bytes]) -> bytes:
    """Return one of ``good`` with one to four changes."""
    raw = bytearray(chance.choice(good))
    for _ in range(chance.randint(1, 4)):
        chance.choice(_CHANGES)(chance, raw, good)
    return bytes(raw)


def _flip(chance: random.Random, raw: bytearray, good: list[bytes]) -> None:
    if raw:
        raw[chance.randrange(len(raw))] ^= 1 << chance.randrange(8)


def _set(chance: random.Random, raw: bytearray, good: list[bytes]) -> None:
    if raw:
        raw[chance.randrange(len(raw))] = chance.randrange(256)


def _cut(chance: random.Random, raw: bytearray, good: list[bytes]) -> None:
    start = chance.randint(0, len(raw))
    del raw[start : start + chance.choice((1, 2, 5, 1000))]


def _insert(chance: random.Random, raw: bytearray, good: list[bytes]) -> None:
    at = chance.randint(0, len(raw))
    raw[at:at] = (
        chance.choice(WILD) if chance.random() < 0.7 else chance.randbytes(chance.randrange(9))
    )


def _repeat(chance: random.Random, raw: bytearray, good: list[bytes]) -> None:
    start = chance.randint(0, len(raw))
    raw[start:start] = raw[start : start + chance.randrange(20)] * chance.randrange(
        1, 300 if chance.random() < 0.01 else 4
    )


def _splice(chance: random.Random, raw: bytearray, good: list[bytes]) -> None:
    other = chance.choice(good)
    raw[chance.randint(0, len(raw)) :] = other[chance.randint(0, len(other)) :]


_CHANGES: tuple[Callable[[random.Random, bytearray, list[bytes]], None], ...] = (
    _flip,
    _flip,
    _set,
    _set,
    _cut,
    _insert,
    _insert,
    _repeat,
    _splice,
)
"""The changes, frequent ones several times."""
