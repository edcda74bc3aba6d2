"""A synthetic recording with identities, in a folder as `bench real` takes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from camtopod.codec import to_json
from camtopod.records import Event

WALKS = 240
EVERY_SECONDS = 30.0


def a_recording(path: Path) -> Path:
    """Write a recording with three kinds of objects and return its folder.

    One kind passes a, then b 9 to 11 s later; one enters the view of c before leaving e; one passes
    d and is not seen again.
    """
    path.mkdir()
    chance, events, rows = np.random.default_rng(3), list[Event](), ["track,identity"]
    for walk in range(WALKS):
        t = 1e6 + chance.uniform(0.0, EVERY_SECONDS * WALKS)
        b = t + 4.0 + chance.uniform(9.0, 11.0)
        e, alone = (1e6 + chance.uniform(0.0, EVERY_SECONDS * WALKS) for _ in range(2))
        for camera, came, left, identity in (
            ("a", t, t + 4.0, walk),
            ("b", b, b + 6.0, walk),
            ("e", e, e + 6.0, WALKS + walk),
            ("c", e + 4.0, e + 12.0, WALKS + walk),
            ("d", alone, alone + 4.0, 2 * WALKS + walk),
        ):
            track = f"{camera}{walk}"
            events += [
                Event(camera, "entry", came, track=track),
                Event(camera, "exit", left, track=track),
            ]
            rows.append(f"{track},{identity}")
    (path / "events.jsonl").write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    (path / "identities.csv").write_text("\n".join(rows) + "\n")
    return path
