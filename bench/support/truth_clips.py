"""Clips with ground truth.

The truth of NAME.mp4 stands beside it, in one of three forms:

- NAME.jsonl: a line for each event, ``{"kind": "entry", "t": 8.25, "x": 0.31, "y": 0.88}``; kind
  is entry or exit, t the position in the file in seconds, x and y the foot point in fractions of
  the picture. Other fields are ignored, so lines of `camtopod grab --out` will do, corrected by
  hand. An empty file stands for a clip without events.
- NAME.json: passages by frame number, as in ``truth_vtest.json`` of this folder. Its
  ``frames_per_second`` is the rate at which the clip is played, whatever its header says.
- truth.json, for several clips: {"NAME.mp4": {"events", "maybe", "skip", "span",
  "height_by_width", "view"}}. ``events`` as lines of NAME.jsonl, with ``person`` where it is known
  whose they are; ``maybe``: events that count neither when told nor when missed; ``skip``: areas
  [left, top, right, bottom] in which nothing counts as wrong; ``span``: first and last second
  judged; ``view``: kind of view.

An object that is in view at the beginning has no entry, one in view at the end has no exit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
from msgspec import Struct

from bench.support.watched_clips import match
from camtopod.records import Event, Kind
from camtopod.vision.detect import Luma
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.capture import Capture, FrameSelector
from camtopod.vision.source.file_times import FPS_UNKNOWN

SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm")
"""File names of clips end so."""
Form = TypeVar("Form")
TRUTH = "truth.json"
"""File with the truth of several clips of a folder."""


class TruthError(Exception):
    """A clip or its truth file cannot be used."""


class Picture(NamedTuple):
    """A picture to analyse: time in seconds, luma (H, W), and for a detector the same in colour."""

    t: float
    luma: Luma
    image: Luma | None = None


@dataclass(frozen=True)
class Clip:
    """Pictures of a fixed camera with the true events."""

    name: str
    variant: str
    """Name of the variant; "" for the clip as it is."""
    truth: tuple[Event, ...]
    """By time; ``track`` is the person, where known."""
    aspect: float
    """Width / height."""
    seconds: float
    settings: VisionSettings
    pictures: Callable[[float, VisionSettings], Iterator[Picture]]
    """Yields the pictures at the settings' rate, at least of the settings' working width. The
    first argument is the time left out at the beginning (seconds), which shifts the sampling.
    """
    maybe: tuple[Event, ...] = ()
    """Events that count neither when found nor when missed."""
    skip: tuple[tuple[float, float, float, float], ...] = ()
    """Areas (left, top, right, bottom) in which nothing is spurious."""
    span: tuple[float, float] = (-math.inf, math.inf)
    """First and last second in which something is spurious."""
    kind: str = ""
    """Kind of view, such as ``straight down``; "" if the truth does not say."""

    def judged(self, events: list[Event]) -> Judgement:
        """Compare a grabber's events with the truth."""
        true = match(self.truth, events, self.aspect)
        extras = [events[j] for j in true.spurious]
        return Judgement(
            [(self.truth[i], events[j]) for i, j in true.pairs],
            [self.truth[i] for i in true.misses],
            extras,
            [
                extras[j]
                for j in match(self.maybe, extras, self.aspect).spurious
                if self.span[0] <= extras[j].t <= self.span[1] and not self._skips(extras[j])
            ],
        )

    def _skips(self, event: Event) -> bool:
        x, y = place_of(event)
        return any(a <= x <= c and b <= y <= d for a, b, c, d in self.skip)


class Judgement(NamedTuple):
    """Events beside the truth."""

    pairs: list[tuple[Event, Event]]
    """True and seen events."""
    misses: list[Event]
    extras: list[Event]
    """Seen events that are no true ones."""
    spurious: list[Event]
    """Those of them that count."""


def place_of(event: Event) -> tuple[float, float]:
    """Return the foot point of an event, which must have one."""
    assert event.x is not None
    assert event.y is not None
    return event.x, event.y


# -- files ------------------------------


class _Line(Struct):
    kind: Kind
    t: float
    x: float
    y: float
    person: str | None = None

    def event(self, camera: str) -> Event:
        return Event(camera, self.kind, self.t, self.x, self.y, self.person)


class _Judged(Struct):
    events: list[_Line]
    maybe: list[_Line] = []
    skip: tuple[tuple[float, float, float, float], ...] = ()
    span: tuple[float, float] = (-math.inf, math.inf)
    height_by_width: float | None = None
    view: str = ""


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


def clips_in(folder: Path, *, colour: bool = False) -> list[Clip]:
    """Return the clips of a folder that have a truth, by name.

    colour: the pictures are in colour as well, for a detector.

    Raises `TruthError` if there is none, or one cannot be used.
    """
    if not folder.is_dir():
        raise TruthError(f"{folder} is no folder")
    clips = [
        clip_of(path, truth, colour=colour)
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in SUFFIXES
        for truth in (path.with_suffix(".jsonl"), path.with_suffix(".json"))
        if truth.exists()
    ]
    if (truth := folder / TRUTH).exists():
        for name, content in _decoded(truth, dict[str, _Judged]).items():
            camera = Path(name).stem
            events, maybe = (
                [line.event(camera) for line in k] for k in (content.events, content.maybe)
            )
            clip = clip_with(camera, folder / name, events, colour=colour)
            clips.append(
                replace(
                    clip,
                    aspect=1.0 / content.height_by_width
                    if content.height_by_width
                    else clip.aspect,
                    maybe=tuple(maybe),
                    skip=content.skip,
                    span=content.span,
                    kind=content.view,
                )
            )
    if not clips:
        raise TruthError(f"{folder}: no clip with a truth ({TRUTH}, or NAME.jsonl of NAME.mp4)")
    return clips


def clip_of(path: Path, truth: Path, name: str = "", *, colour: bool = False) -> Clip:
    """Return the clip in the file ``path`` with the events of its own truth file, of either form.

    Raises `TruthError`.
    """
    name = name or path.stem
    if truth.suffix == ".jsonl":
        lines = [line for line in truth.read_bytes().splitlines() if line.strip()]
        events = [_decoded(truth, _Line, line).event(name) for line in lines]
        return clip_with(name, path, events, colour=colour)
    content = _decoded(truth, _Passages)
    fps = content.frames_per_second
    kinds: tuple[Kind, Kind] = ("entry", "exit")
    events = [
        Event(name, kind, at.frame / fps, at.x, at.y)
        for passage in content.passages
        for kind, at in zip(kinds, (passage.entry, passage.exit), strict=True)
        if at is not None
    ]
    return clip_with(name, path, events, fps, colour=colour)


def _decoded(path: Path, kind: type[Form], text: bytes | None = None) -> Form:
    try:
        return msgspec.json.decode(path.read_bytes() if text is None else text, type=kind)
    except (msgspec.DecodeError, OSError) as error:
        raise TruthError(f"{path}: {error}{f' in {text.decode()}' if text else ''}") from None


def clip_with(
    name: str, path: Path, truth: list[Event], fps: float | None = None, *, colour: bool = False
) -> Clip:
    """Return a clip with its true events, after reading the file once to know its length.

    fps: frame rate to play at; None for the file's own time stamps.

    Raises `TruthError`.
    """
    settings = VisionSettings()
    capture = Capture(str(path), settings)
    frames, last = 0, 0.0
    while (stamp := capture.grab()) is not None:
        frames, last = frames + 1, max(last, stamp)
    file_fps = capture.fps or FPS_UNKNOWN
    (width, height), rate = capture.size, fps or file_fps
    capture.release()
    if not frames:
        raise TruthError(f"{path}: no frame in it can be decoded")

    def pictures(left_out: float, settings: VisionSettings) -> Iterator[Picture]:
        return _read(path, fps, left_out, settings, colour)

    seconds = frames / rate if fps else max(last, (frames - 1) / rate)
    by_time = tuple(sorted(truth, key=lambda event: event.t))
    return Clip(name, "", by_time, width / height, seconds, settings, pictures)


def _read(
    path: Path, fps: float | None, left_out: float, settings: VisionSettings, colour: bool
) -> Iterator[Picture]:
    """Yield the pictures that the grabber would analyse.

    fps: frame rate to play at; None for the file's own time stamps.
    left_out, seconds: frames before are left out.
    """
    capture = Capture(str(path), settings, colour)
    cadence = FrameSelector(settings.analysed_fps)
    step = 1.0 / (fps or capture.fps or FPS_UNKNOWN)
    t = -step
    while (stamp := capture.grab()) is not None:
        t = stamp if fps is None and (stamp > t or t < 0.0) else t + step
        if t >= left_out and cadence.wants(t):
            frame = capture.frame()
            if frame is not None:  # the capture fills its buffer again
                yield Picture(t, frame.luma.copy(), frame.image)
    capture.release()
