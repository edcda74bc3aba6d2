"""Damaged messages: valid ones with bits, bytes and pieces changed."""

from __future__ import annotations

import random

from camtopod.codec import to_json, to_msgpack
from camtopod.records import Event
from camtopod.serve.requests import Answer, Batch, Hello

WILD = (
    b"\x00 \xff \xc1 \xc0 \x80 \xdf\xff\xff\xff\xff \xdd\x00\x0f\xff\xff".split()
    + b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00 \xcb\x7f\xf0\x00\x00\x00\x00\x00\x00".split()
    + rb'1e999 -1 NaN null " { } \ud800'.split()
    + [b"9" * 30, b"[" * 50, b"\x9f" * 50, b"\xcf" + b"\xff" * 8, b"\xed\xa0\x80", b"\x00\x00"]
)
"""Byte strings that are inserted."""


def seeds(camera: str) -> list[bytes]:
    """Return valid events of a camera in both encodings."""
    t = 1_700_000_000.25
    events: list[object] = [
        Event(camera, "entry", t),
        Event(camera, "exit", t, 0.31, 0.88, "17", "b1", 1041, 0.02),
        Event(camera, "entry", t, 0.0, 1.0, "x" * 40, "b1", 2**40),
        Event(camera, "exit", -1.5, 0.5, 0.5, "ü", "", 0),
        {"camera": camera, "kind": "exit", "t": t, "more": {"deep": [[{"a": [1, None, "é"]}]]}},
    ]
    return [*map(to_json, events), *map(to_msgpack, events)]


def requests(camera: str) -> list[bytes]:
    """Return valid requests on ``store/{camera}``."""
    events = [(seq, raw) for seq, raw in enumerate(seeds(camera), 1)]
    return [
        to_msgpack(Hello("h1", ["b0", "b1"])),
        to_msgpack(Batch("h1", "b1", 0, events, 17)),
        to_msgpack(Batch("h1", "b1", 2**40, [])),
    ]


def answers() -> list[bytes]:
    """Return valid answers to requests."""
    return [
        to_msgpack(Answer({"b0": 3, "b1": 2**40}, 500)),
        to_msgpack(Answer({}, 1, "held")),
        to_msgpack(Answer({"b1": 0}, 7, "cameras", "there are too many", 3, 4)),
    ]


def mutant(chance: random.Random, good: list[bytes]) -> bytes:
    """Return one of ``good`` with one to four changes."""
    raw = bytearray(chance.choice(good))
    for _ in range(chance.randint(1, 4)):
        change = chance.choice(
            ["flip", "set", "insert", "flip", "set", "insert", "cut", "repeat", "splice"]
        )
        at = chance.randint(0, len(raw))
        if change == "flip" and at < len(raw):
            raw[at] ^= 1 << chance.randrange(8)
        elif change == "set" and at < len(raw):
            raw[at] = chance.randrange(256)
        elif change == "insert":
            rubbish = chance.randbytes(chance.randrange(9))
            raw[at:at] = chance.choice(WILD) if chance.random() < 0.7 else rubbish
        elif change == "cut":
            del raw[at : at + chance.choice((1, 2, 5, 1000))]
        elif change == "repeat":
            times = chance.randrange(1, 300 if chance.random() < 0.01 else 4)
            raw[at:at] = raw[at : at + chance.randrange(20)] * times
        elif change == "splice":
            other = chance.choice(good)
            raw[at:] = other[chance.randint(0, len(other)) :]
    return bytes(raw)
