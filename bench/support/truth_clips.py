"""Clips with ground truth.

The truth of NAME.mp4 stands beside it, in one of two forms:

- NAME.jsonl: a line for each event, ``{"kind": "entry", "t": 8.25, "x": 0.31, "y": 0.88}``; kind
  is entry or exit, t the position in the file in seconds, x and y the foot point in fractions of
  the picture. Other fields are ignored, so lines of `camtopod grab --out` will do, corrected by
  hand. An empty file stands for a clip without events.
- NAME.json: passages by frame number, as in ``truth_vtest.json`` of this folder. Its
  ``frames_per_second`` is the rate at which the clip is played, whatever its header says.

An object that is in view at the beginning has no entry, one in view at the end has no exit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from bench.support.watched_clips import DIAGONALS
from camtopod.records import Event, Kind
from camtopod.vision.detect import Luma
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import Capture, FrameSelector
from camtopod.vision.source.file_times import FPS_UNKNOWN

SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm")
"""File names of clips end so."""


class TruthError(Exception):
    """A clip or its truth file cannot be used."""


class Picture(NamedTuple):
    """A picture to analyse: time in seconds, luma (H, W)."""

    t: float
    luma: Luma


@dataclass(frozen=True)
class Clip:
    """Pictures of a fixed camera with the true events."""

    name: str
    variant: str
    """Name of the variant; "" for the clip as it is."""
    truth: tuple[Event, ...]
    aspect: float
    """Width / height."""
    seconds: float
    rate: float
    """Frames a second."""
    settings: VisionSettings
    pictures: Callable[[int, VisionSettings], Iterator[Picture]]
    """Yields the pictures at the settings' rate, at least of the settings' working width. The
    first argument is the number of frames left out at the beginning, which shifts the sampling.
    """
    seam: float | None = None
    """x of the line between two clips side by side; nothing is scored near it."""

    def frames_skipped(self, phase: int, phases: int) -> int:
        """Return how many frames the sampling of number ``phase`` of ``phases`` leaves out."""
        return phase * max(1, round(self.rate / self.settings.analysed_fps / phases))

    def scored(self, event: Event) -> bool:
        """Return False for an event near the seam."""
        if self.seam is None or event.x is None:
            return True
        diagonal = float(np.hypot(self.aspect, 1.0))
        return abs(event.x - self.seam) * self.aspect > DIAGONALS * diagonal


# -- files ------------------------------


class _Line(Struct):
    kind: Kind
    t: float
    x: float
    y: float


class _At(Struct):
    frame: int
    x: float
    y: float


class _Passage(Struct):
    entry: _At | None = None
    exit: _At | None = None


class _Passages(Struct):
    frames_per_second: float
    passages: list[_Passage]


def clips_in(folder: Path) -> list[Clip]:
    """Return the clips of a folder that have a truth file beside them, by name.

    Raises `TruthError` if there is none, or one cannot be used.
    """
    if not folder.is_dir():
        raise TruthError(f"{folder} is no folder")
    found = [
        clip_of(path, truth)
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in SUFFIXES
        for truth in (path.with_suffix(".jsonl"), path.with_suffix(".json"))
        if truth.exists()
    ]
    if not found:
        raise TruthError(f"{folder}: no clip with a truth file (NAME.mp4 with NAME.jsonl)")
    return found


def clip_of(path: Path, truth: Path, name: str = "") -> Clip:
    """Return the clip in the file ``path`` with the events of a truth file of either form.

    Raises `TruthError`.
    """
    fps: float | None = None
    events: list[Event] = []
    name = name or path.stem
    where = str(truth)
    try:
        if truth.suffix == ".jsonl":
            for number, line in enumerate(truth.read_bytes().splitlines(), 1):
                where = f"{truth}:{number}"
                if line.strip():
                    one = msgspec.json.decode(line, type=_Line)
                    events.append(Event(name, one.kind, one.t, one.x, one.y))
        else:
            said = msgspec.json.decode(truth.read_bytes(), type=_Passages)
            fps = said.frames_per_second
            for passage in said.passages:
                if passage.entry is not None:
                    events.append(_event(name, "entry", passage.entry, fps))
                if passage.exit is not None:
                    events.append(_event(name, "exit", passage.exit, fps))
    except (msgspec.DecodeError, OSError) as error:
        raise TruthError(f"{where}: {error}") from None
    return _clip(name, path, tuple(sorted(events, key=lambda event: event.t)), fps)


def _event(name: str, kind: Kind, at: _At, fps: float) -> Event:
    return Event(name, kind, at.frame / fps, at.x, at.y)


def _clip(name: str, path: Path, truth: tuple[Event, ...], fps: float | None) -> Clip:
    """Return a clip, after reading the file once to know its length."""
    settings = VisionSettings()
    capture = Capture(str(path), settings)
    frames, last = 0, 0.0
    while (stamp := capture.grab()) is not None:
        frames, last = frames + 1, max(last, stamp)
    declared = capture.fps or FPS_UNKNOWN
    (width, height), rate = capture.size, fps or declared
    capture.release()
    if not frames:
        raise TruthError(f"{path}: no frame in it can be decoded")

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        return _read(path, fps, skipped, settings)

    seconds = frames / rate if fps else max(last, (frames - 1) / rate)
    return Clip(name, "", truth, width / height, seconds, rate, settings, pictures)


def _read(
    path: Path, fps: float | None, skipped: int, settings: VisionSettings
) -> Iterator[Picture]:
    """Yield the pictures that the grabber would analyse.

    fps: frame rate to play at; None for the file's own time stamps.
    skipped: frames left out at the beginning.
    """
    capture = Capture(str(path), settings)
    cadence = FrameSelector(settings.analysed_fps)
    step = 1.0 / (fps or capture.fps or FPS_UNKNOWN)
    number, t = 0, -step
    while (stamp := capture.grab()) is not None:
        t = stamp if fps is None and (stamp > t or not number) else t + step
        number += 1
        if number > skipped and cadence.wants(t):
            luma = capture.retrieve()
            if luma is not None:
                yield Picture(t, luma.copy())  # the capture fills its buffer again
    capture.release()
