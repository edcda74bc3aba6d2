"""Draw what the pipeline made of a frame into an enlarged copy of the working image.

Green: an object; grey: a track that is not one yet, or is lost at the moment; yellow: foreground;
red: ignored areas; blue: doors; violet: what the detector found in this frame. Events are discs at
their place: an entry green, an exit red. Below the image are the latest decisions in words.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from camtopod.records import Event
from camtopod.vision.pipeline import Analysis
from camtopod.vision.settings import VisionSettings
from camtopod.vision.show.decision_words import clock_words, words_of
from camtopod.vision.show.shown_file import (
    SHOWN_SECONDS,
    Image,
    ImageFile,
    VideoFile,
    open_shown_file,
)
from camtopod.vision.track import Track

log = logging.getLogger(__name__)

WIDTH = 960
"""Width of the drawn image, pixels; the working image's longer side is enlarged to it."""
LINES = 8
"""Decisions shown below the image."""
LINE_PIXELS = 20
"""Height of a line of words, and diameter of an event or a door, pixels."""

Colour = tuple[int, int, int]
_OBJECT: Colour = (80, 220, 80)
_TENTATIVE: Colour = (170, 170, 170)
_FOREGROUND: Colour = (60, 220, 240)
_IGNORED: Colour = (70, 70, 220)
_DOOR: Colour = (240, 150, 60)
_DETECTION: Colour = (220, 120, 220)
_ENTRY: Colour = (60, 200, 60)
_EXIT: Colour = (90, 90, 250)
_REASONS: dict[str, Colour] = {"entered": _ENTRY, "left": _EXIT}
_WORDS: Colour = (235, 235, 235)
_GROUND: Colour = (24, 24, 24)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_SCALE = cv2.getFontScaleFromHeight(_FONT, LINE_PIXELS // 2)


class Preview:
    """Draws analysed frames into a file until it cannot be written any more.

    Remembers the last seconds of one view.
    """

    def __init__(self, path: Path, camera: str, settings: VisionSettings) -> None:
        """Make sure that the file can be written. Raises `ShowError` if not.

        If it cannot be written later on, that is logged once.
        """
        self._file: ImageFile | VideoFile | None = open_shown_file(path, settings.analysed_fps)
        self._path = path
        self._camera = camera
        self._settings = settings
        self._latest: Analysis | None = None
        self._feet: list[tuple[float, int, tuple[float, float]]] = []
        """Time (seconds), track number and foot point (pixels of the working image)."""
        self._events: list[tuple[float, Event]] = []
        """Time (seconds) from which an event is drawn, and the event."""
        self._lines: deque[tuple[Colour, str]] = deque(maxlen=LINES)

    def __call__(self, analysis: Analysis) -> None:
        """Take in a frame, and draw it if the file wants it."""
        if self._file is None:
            return
        self._remember(analysis)
        if self._file.wants(analysis.t):
            self._write(self._file.write, analysis)

    def close(self) -> None:
        """Write the last image and complete the file."""
        if self._file is not None and self._latest is not None:
            self._write(self._file.finish, self._latest)

    def _write(self, write: Callable[[float, Image], None], analysis: Analysis) -> None:
        """Draw a frame and write it; if that fails, say why and stop drawing."""
        try:
            write(analysis.t, self._drawn(analysis))
        except OSError as error:
            self._file = None  # which completes a video
            reason = f"cannot write {self._path}: {error.strerror}"
            log.warning("--show: %s; it is not written any more, events go on", reason)

    def _remember(self, analysis: Analysis) -> None:
        """Take in the feet, events and decisions of a frame. Costs little."""
        self._latest = analysis
        self._feet += (
            (analysis.t, track.number, track.last.foot)
            for track in analysis.tracks
            if track.last.t == analysis.t
        )
        self._events += ((analysis.t, event) for event in analysis.events)
        since = analysis.t - SHOWN_SECONDS
        self._feet = [mark for mark in self._feet if mark[0] >= since]
        self._events = [mark for mark in self._events if mark[0] >= since]
        for decision in analysis.decisions:
            text = f"{clock_words(decision.t)} track {decision.track}: {words_of(decision)}"
            self._lines.append((_REASONS.get(decision.reason, _TENTATIVE), text))

    def _drawn(self, analysis: Analysis) -> Image:
        """Return the drawn image of a frame that was remembered last."""
        height, width = analysis.frame.shape
        factor = WIDTH / max(height, width)
        high = 2 * round(factor * height / 2)  # video needs even numbers
        canvas = np.full((high + LINES * LINE_PIXELS, WIDTH, 3), _GROUND, np.uint8)
        image = canvas[:high, : round(factor * width)]
        size = image.shape[1::-1]
        image[:] = cv2.resize(analysis.frame, size)[:, :, None]

        # Areas, doors, foreground.
        for areas, colour in ((self._settings.ignore, _IGNORED), (self._settings.doors, _DOOR)):
            for area in areas:
                _draw_corners(image, np.multiply(area, size), colour)
        for door in analysis.learned_doors:
            _draw_corners(image, factor * np.array([door]), _DOOR)
        if analysis.moving_mask is not None:
            moving_mask = cv2.resize(analysis.moving_mask, size, interpolation=cv2.INTER_NEAREST)
            outlines, _ = cv2.findContours(moving_mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
            cv2.drawContours(image, outlines, -1, _FOREGROUND)

        # Detections, tracks, events.
        state = "" if analysis.moving_mask is not None else "  blind, or most of the image differs"
        if analysis.detector is not None:
            state += f"  detector {'' if analysis.detector.is_trusted else 'not '}trusted, "
            state += f"agreement {analysis.detector.agreement:.2f}"
            for detection in analysis.detector.detections:
                _draw_box(
                    image,
                    factor,
                    detection.box,
                    f"{detection.label} {detection.score:.2f}",
                    _DETECTION,
                )
        for track in analysis.tracks:
            self._draw_track(image, track, factor, analysis.t)
        for _, event in self._events:
            _draw_event(image, event)

        # Words.
        _write(canvas, (0, 0), f"{self._camera}  {clock_words(analysis.t)}{state}", _WORDS)
        for row, (colour, text) in enumerate(self._lines):
            _write(canvas, (0, high + row * LINE_PIXELS), text, colour)
        return canvas

    def _draw_track(self, image: Image, track: Track, factor: float, t: float) -> None:
        """Draw box, number and path of a track at ``t`` (seconds)."""
        is_lost = track.last.t < t
        colour = _OBJECT if track.confirmed and not is_lost else _TENTATIVE
        label = f"{track.number}{'' if track.confirmed else '?'}{' lost' if is_lost else ''}"
        _draw_box(image, factor, track.last.box, label, colour)
        feet = [foot for _, number, foot in self._feet if number == track.number]
        if feet:
            points = (factor * np.array(feet)).round().astype(np.int32)
            cv2.polylines(image, [points], False, colour)


def _draw_corners(image: Image, corners: np.ndarray, colour: Colour) -> None:
    """Draw a polygon, or a disc at a single point; ``corners`` (N, 2) in pixels."""
    thickness = 2 if len(corners) > 1 else LINE_PIXELS
    cv2.polylines(image, [corners.round().astype(np.int32)], True, colour, thickness)


def _draw_box(
    image: Image, factor: float, box: Sequence[float], label: str, colour: Colour
) -> None:
    """Draw a box (left, top, right, bottom; pixels of the working image) with a label above it."""
    left, top, right, bottom = (round(factor * value) for value in box)
    cv2.rectangle(image, (left, top), (right, bottom), colour, 2)
    _write(image, (left, top - LINE_PIXELS), label, colour)


def _draw_event(image: Image, event: Event) -> None:
    """Draw an event at its place, with words beside it."""
    height, width = image.shape[:2]
    at = (round((event.x or 0.0) * width), round((event.y or 0.0) * height))
    colour = _ENTRY if event.kind == "entry" else _EXIT
    cv2.circle(image, at, LINE_PIXELS // 2, colour, cv2.FILLED)
    _write(image, at, f"{event.kind} {event.track}", colour)


def _write(image: Image, at: tuple[int, int], text: str, colour: Colour) -> None:
    """Write text whose upper left corner is ``at``, or as near as it fits, on a dark ground."""
    height, width = image.shape[:2]
    (wide, _), _ = cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)
    x = max(0, min(at[0], width - wide))
    y = max(0, min(at[1], height - LINE_PIXELS))
    cv2.rectangle(image, (x, y), (x + wide, y + LINE_PIXELS - 1), _GROUND, cv2.FILLED)
    cv2.putText(
        image, text, (x, y + LINE_PIXELS * 3 // 4), _FONT, _FONT_SCALE, colour, 1, cv2.LINE_AA
    )
