"""Clips with ground truth, and variants of them: more of what real video there is.

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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
from msgspec import Struct

from bench.support.watched_clips import DIAGONALS
from camtopod.records import Event, Kind
from camtopod.vision import VisionSettings
from camtopod.vision.detect import Luma
from camtopod.vision.source.capture import Capture, FrameSelector
from camtopod.vision.source.recorded import FPS_UNKNOWN

SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm")
"""File names of clips end so."""
SLOWER = 1.5
"""Factor on the times of a slowed clip."""
DARKER = 0.5
"""Factor on the luma of a darkened clip."""
SHAKE_SHARE = 0.004
"""Standard deviation of a shaken picture's shift, as a share of its width."""
SHAKE_SHARE_MAX = 0.0125
"""Largest shift of a shaken picture, as a share of its width; this margin is cut off."""
CROP_SHARE_MAX, CROP_SHARE_MIN = 0.2, 0.03
"""Largest and least share of the picture that is cropped at a side."""
CROP_CLEAR_SHARE = 0.25
"""Share of the picture that remains between a cropped side and the nearest foot point."""
DETAIL_FACTOR = 2
"""Crops are taken from pictures of this many times the working width."""


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
    while (grab := capture.grab()) is not None:
        frames, last = frames + 1, max(last, grab.stamp)
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
    while (grab := capture.grab()) is not None:
        t = grab.stamp if fps is None and (grab.stamp > t or not number) else t + step
        number += 1
        if number > skipped and cadence.wants(t):
            luma = capture.retrieve()
            if luma is not None:
                yield Picture(t, luma.copy())  # the capture fills its buffer again
    capture.release()


# -- variants ------------------------------


def mirrored(clip: Clip) -> Clip:
    """Return the clip with left and right exchanged."""

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        for picture in clip.pictures(skipped, settings):
            yield picture._replace(luma=np.ascontiguousarray(picture.luma[:, ::-1]))

    truth = [msgspec.structs.replace(event, x=1.0 - _at(event)[0]) for event in clip.truth]
    return replace(clip, variant="mirrored", truth=tuple(truth), pictures=pictures)


def backwards(clip: Clip) -> Clip:
    """Return the clip reversed in time: entries become exits."""

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        for picture in reversed(list(clip.pictures(skipped, settings))):
            yield picture._replace(t=max(0.0, clip.seconds - picture.t))

    truth = [
        msgspec.structs.replace(
            event,
            kind="exit" if event.kind == "entry" else "entry",
            t=max(0.0, clip.seconds - event.t),
        )
        for event in reversed(clip.truth)
    ]
    return replace(clip, variant="backwards", truth=tuple(truth), pictures=pictures)


def darkened(clip: Clip) -> Clip:
    """Return the clip with less light, and so less contrast."""

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        for picture in clip.pictures(skipped, settings):
            yield picture._replace(luma=cv2.convertScaleAbs(picture.luma, alpha=DARKER))

    return replace(clip, variant="darkened", pictures=pictures)


def shaken(clip: Clip) -> Clip:
    """Return the clip as of a camera that trembles: each picture has its own shift."""

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        rng = np.random.default_rng(1)
        detailed = _detailed(settings)
        for picture in clip.pictures(skipped, detailed):
            height, width = picture.luma.shape
            margin = max(1, round(SHAKE_SHARE_MAX * width))
            shift = np.clip(rng.normal(0.0, SHAKE_SHARE * width, 2), -margin, margin)
            x, y = (margin + shift.round().astype(np.int64)).tolist()
            luma = picture.luma[y : y + height - 2 * margin, x : x + width - 2 * margin]
            yield picture._replace(luma=np.ascontiguousarray(luma))

    return replace(clip, variant="shaken", pictures=pictures)


def cropped(clip: Clip) -> Clip | None:
    """Return the clip without the margins that no event is near to; None if there is hardly any.

    Where nobody enters or leaves, passages remain as they are. Somebody may still walk through a
    margin in between, who is then cut.
    """
    if not clip.truth:
        return None
    at = np.array([_at(event) for event in clip.truth])
    room = np.concatenate([at.min(axis=0), 1.0 - at.max(axis=0)]) - CROP_CLEAR_SHARE
    cut = np.where(room < CROP_SHARE_MIN, 0.0, np.minimum(room, CROP_SHARE_MAX))
    left, top, right, bottom = cut.tolist()
    if not cut.any():
        return None

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        for picture in clip.pictures(skipped, _detailed(settings)):
            height, width = picture.luma.shape
            rows = slice(round(top * height), round((1.0 - bottom) * height))
            columns = slice(round(left * width), round((1.0 - right) * width))
            yield picture._replace(luma=np.ascontiguousarray(picture.luma[rows, columns]))

    wide, high = 1.0 - left - right, 1.0 - top - bottom
    truth = [
        msgspec.structs.replace(event, x=(x - left) / wide, y=(y - top) / high)
        for event, (x, y) in zip(clip.truth, at.tolist(), strict=True)
    ]
    aspect = clip.aspect * wide / high
    return replace(clip, variant="cropped", truth=tuple(truth), aspect=aspect, pictures=pictures)


def slowed(clip: Clip) -> Clip:
    """Return the clip played more slowly; pictures are taken as often as before."""

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        # The same pictures as of the clip itself at a higher rate.
        faster = msgspec.structs.replace(settings, analysed_fps=SLOWER * settings.analysed_fps)
        for picture in clip.pictures(skipped, faster):
            yield picture._replace(t=SLOWER * picture.t)

    truth = [msgspec.structs.replace(event, t=SLOWER * event.t) for event in clip.truth]
    return replace(
        clip,
        variant="slowed",
        truth=tuple(truth),
        seconds=SLOWER * clip.seconds,
        rate=clip.rate / SLOWER,
        pictures=pictures,
    )


def side_by_side(left: Clip, right: Clip) -> Clip:
    """Return two clips as one wide picture, as long as the shorter of them.

    Both halves are as large as they are alone. Nothing is scored near the seam, where people
    vanish in mid-view.
    """
    total = left.aspect + right.aspect
    seam = left.aspect / total
    seconds = min(left.seconds, right.seconds)
    # The halves have the height of the first, so the second one's width follows from its shape.
    width = round(left.settings.working_width / seam)

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        single = msgspec.structs.replace(settings, working_width=left.settings.working_width)
        others = right.pictures(skipped, single)
        other = next(others, None)
        following = next(others, None)
        for picture in left.pictures(skipped, single):
            # The other clip's newest picture.
            while following is not None and following.t <= picture.t:
                other, following = following, next(others, None)
            if other is None or picture.t > seconds:
                return
            height = len(picture.luma)
            size = (round(right.aspect * height), height)
            beside = cv2.resize(other.luma, size, interpolation=cv2.INTER_AREA)
            yield picture._replace(luma=np.hstack([picture.luma, beside]))

    def at_half(clip: Clip, begin: float, share: float) -> list[Event]:
        return [
            msgspec.structs.replace(event, x=begin + share * _at(event)[0])
            for event in clip.truth
            if event.t <= seconds
        ]

    truth = at_half(left, 0.0, seam) + at_half(right, seam, 1.0 - seam)
    return Clip(
        f"{left.name} + {right.name}",
        "side by side",
        tuple(sorted(truth, key=lambda event: event.t)),
        total,
        seconds,
        left.rate,
        msgspec.structs.replace(left.settings, working_width=width),
        pictures,
        seam,
    )


VARIANTS: dict[str, Callable[[Clip], Clip | None]] = {
    "mirrored": mirrored,
    "backwards": backwards,
    "cropped": cropped,
    "darkened": darkened,
    "shaken": shaken,
    "slowed": slowed,
}
"""Variants of a single clip by name; None where a clip has none."""
SIDE_BY_SIDE = "side by side"
"""Name of the variant of two clips."""


def with_variants(clips: list[Clip]) -> list[Clip]:
    """Return the clips, then their variants, and each clip beside the next one."""
    result = list(clips)
    for variant in VARIANTS.values():
        result += [made for clip in clips if (made := variant(clip)) is not None]
    if len(clips) > 1:
        result += [side_by_side(a, b) for a, b in zip(clips, clips[1:] + clips[:1], strict=True)]
    return result


def _detailed(settings: VisionSettings) -> VisionSettings:
    """Return settings of pictures with more detail than is analysed, to cut from."""
    return msgspec.structs.replace(settings, working_width=DETAIL_FACTOR * settings.working_width)


def _at(event: Event) -> tuple[float, float]:
    """Return the foot point of a true event, which always has one."""
    assert event.x is not None
    assert event.y is not None
    return event.x, event.y
