"""Passages annotated by hand on two real clips, and their comparison with a grabber's events."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camtopod.records import Event

SECONDS = 1.5
"""Tolerance of an event's time, seconds."""
DIAGONALS = 0.12
"""Tolerance of an event's position, as a share of the image's diagonal."""
HERE = Path(__file__).parent
"""Folder of the annotations."""
VTEST = Path("/usr/share/doc/opencv-doc/examples/data/vtest.avi")
"""The second clip, of Debian's package opencv-doc.

It was recorded at 7 frames a second, though its header says 10.
"""


def one_by_one() -> Path | None:
    """Return the path of the clip of people one at a time, or None where the data is missing."""
    folder = os.environ.get("CAMTOPOD_TEST_DATA")
    path = Path(folder or ".") / "one-by-one" / "one-by-one-person-detection.mp4"
    return path if folder and path.exists() else None


@dataclass(frozen=True)
class Match:
    """Pairs of (true, seen) indices, and the rest on either side."""

    pairs: list[tuple[int, int]]
    misses: list[int]
    spurious: list[int]

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 1.0 if there was nothing to see or seen."""
        total = 2 * len(self.pairs) + len(self.misses) + len(self.spurious)
        return 2 * len(self.pairs) / total if total else 1.0


def watched(name: str, fps: float) -> list[Event]:
    """Return the passages of ``truth_{name}.json`` as events, played at ``fps`` frames a second."""
    passages = json.loads((HERE / f"truth_{name}.json").read_text())["passages"]
    return [
        Event(
            camera=name,
            kind=kind,
            t=passage[kind]["frame"] / fps,
            x=passage[kind]["x"],
            y=passage[kind]["y"],
        )
        for passage in passages
        for kind in ("entry", "exit")
        if kind in passage
    ]


def match(truth: Sequence[Event], events: Sequence[Event], aspect: float) -> Match:
    """Return one-to-one pairs of one kind within the tolerances, the nearest first.

    ``aspect`` is the image's width / height. What is near is the sum of the distances in time and
    in the image, as shares of their tolerances.
    """
    near = []
    diagonal = math.hypot(aspect, 1.0)
    for i, a in enumerate(truth):
        for j, b in enumerate(events):
            assert a.x is not None and a.y is not None and b.x is not None and b.y is not None  # noqa: PT018
            seconds = abs(a.t - b.t) / SECONDS
            distance = math.hypot(aspect * (a.x - b.x), a.y - b.y) / diagonal / DIAGONALS
            if a.kind == b.kind and max(seconds, distance) <= 1.0:
                near.append((seconds + distance, i, j))

    # The rest of either side.
    misses, spurious, pairs = set(range(len(truth))), set(range(len(events))), []
    for _, i, j in sorted(near):
        if i in misses and j in spurious:
            pairs.append((i, j))
            misses.remove(i)
            spurious.remove(j)
    return Match(pairs, sorted(misses), sorted(spurious))


def best_offset(reference: list[Event], events: list[Event], aspect: float) -> float:
    """Return the seconds to subtract from the times of ``events`` for the most matches.

    This is the difference of the clocks. Candidates are the differences of single events; the
    median difference of the matches refines the best.
    """
    candidates = {round(b.t - a.t, 1) for a in reference for b in events if a.kind == b.kind}
    best = max(
        candidates,
        key=lambda c: len(match(reference, shifted(events, c), aspect).pairs),
        default=0.0,
    )
    pairs = match(reference, shifted(events, best), aspect).pairs
    return float(np.median([events[j].t - reference[i].t for i, j in pairs])) if pairs else best


def shifted(events: list[Event], seconds: float) -> list[Event]:
    """Return the events, ``seconds`` earlier."""
    return [Event(e.camera, e.kind, e.t - seconds, e.x, e.y, e.track) for e in events]
