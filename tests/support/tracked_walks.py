"""A walker who crosses a view from x = 0.02 to 0.98 in ten seconds, as several programs tell it."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from camtopod.cli.main import main
from camtopod.codec import event_from_json

T = 1_700_000_000.0
FRAMES = 150
"""Frames of a recording, ten a second; the walker is there from 2 s to 12 s."""
PASSAGE = [("entry", 2.0, 0.02), ("exit", 12.0, 0.98)]
SIZE = ["--size", "1000x500"]

Line = Callable[[float, float | None, str], Any]
"""Returns a frame at a time with the walker at x, if there is one, and its kind."""


def iso(t: float) -> str:
    return datetime.fromtimestamp(T + t, UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def axis(t: float, x: float | None, kind: str, unit: float = 1.0) -> Any:
    seen = []
    if x is not None:
        sides = {"left": x - 0.02, "right": x + 0.02, "top": 0.4, "bottom": 0.8}
        box = {side: unit * value for side, value in sides.items()}
        seen = [
            {"bounding_box": box, "track_id": "7", **({"class": {"type": kind}} if kind else {})}
        ]
    return {"frame": {"timestamp": iso(t), "observations": seen, "operations": []}}


def onvif(t: float, x: float | None, kind: str, unit: float = 1.0) -> Any:
    seen = []
    if x is not None:
        sides = {"@left": 2 * x - 1.04, "@right": 2 * x - 0.96, "@top": 0.2, "@bottom": -0.6}
        box = {side: unit * value for side, value in sides.items()}
        what = {"Class": {"Type": [{"#text": kind}]}} if kind else {}
        seen = [{"@ObjectId": 7, "Appearance": {"Shape": {"BoundingBox": box}, **what}}]
    return {"Frame": [{"@UtcTime": iso(t), "Object": seen}]}


def deepstream(t: float, x: float | None, kind: str) -> Any:
    seen = [] if x is None else [f"7|{1000 * x - 20}|200|{1000 * x + 20}|400|{kind}|#|"]
    return {"@timestamp": iso(t), "sensorId": "lobby", "objects": seen}


def scenescape(t: float, x: float | None, kind: str) -> Any:
    objects = {}
    if x is not None:
        box = {"x": 1000 * x - 20, "y": 200, "width": 40, "height": 200}
        objects = {kind: [{"id": 7, "bounding_box_px": box}]}
    return {"id": "lobby", "timestamp": iso(t), "objects": objects}


FORMATS: dict[str, tuple[Line, list[str]]] = {
    "axis": (axis, ["--camera", "lobby"]),
    "onvif": (onvif, ["--camera", "lobby"]),
    "deepstream": (deepstream, SIZE),
    "scenescape": (scenescape, SIZE),
    "scenescape --tracked": (scenescape, [*SIZE, "--tracked"]),
}


def walk(
    line: Line, kind_at: Callable[[float], str] = lambda _: "Human", start: float = 0.0
) -> list[Any]:
    """Return a recording that begins at ``start``; kind_at: seconds in view -> kind."""
    frames = []
    for n in range(FRAMES):
        x = round(0.02 + 0.0096 * (n - 20), 4) if 20 <= n <= 120 else None
        frames.append(line(start + n / 10, x, kind_at((n - 20) / 10)))
    return frames


def ingested(
    tmp_path: Path, line: str, messages: list[Any], *options: str
) -> tuple[int, list[Any]]:
    """Return the exit status of `camtopod ingest`, and the events."""
    source, out = tmp_path / "in", tmp_path / "out"
    source.write_text("".join(f"{m if isinstance(m, str) else json.dumps(m)}\n" for m in messages))
    status = main(["ingest", line.split()[0], str(source), *options, "--out", str(out)])
    return status, [event_from_json(text) for text in out.read_bytes().splitlines()]


def short(events: list[Any]) -> list[tuple[Any, ...]]:
    return [(e.kind, round(e.t - T, 3), e.x) for e in events]


# --- one decision a track -------------------------------------------------------------------------
