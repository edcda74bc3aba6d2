"""Draw what the pipeline made of a frame into an enlarged copy of the working picture.

Green: an object; grey: a track that is not one yet, or is lost at the moment; yellow: foreground;
red: ignored areas; blue: doors, named ones filled; violet: what the detector found in this frame.
Events are discs at their place: an entry green, an exit red. Below the picture are the latest
decisions in words.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from camtopod.records import Event
from camtopod.vision.detect import Luma
from camtopod.vision.detector.detector import DetectorResult
from camtopod.vision.pipeline import Analysis
from camtopod.vision.settings import Polygon, VisionSettings
from camtopod.vision.show.decision_words import clock_words, words_of
from camtopod.vision.show.shown_file import (
    Picture,
    PictureFile,
    ShowError,
    VideoFile,
    open_shown_file,
)
from camtopod.vision.track import Track

log = logging.getLogger(__name__)

WIDTH = 960
"""Width of the drawn picture, pixels; the working picture's longer side is enlarged to it."""
PATH_SECONDS = 5.0
"""Length of the drawn paths, seconds."""
EVENT_SECONDS = 3.0
"""Time for which an event is drawn, seconds."""
LINES = 8
"""Decisions shown below the picture."""
LINE_PIXELS = 20
"""Height of one line of words, pixels."""

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
_FONT_SCALE = 0.42


class Preview:
    """Draws analysed frames into a file until it cannot be written any more.

    Remembers the last seconds of one view.
    """

    def __init__(self, path: Path, camera: str, settings: VisionSettings) -> None:
        """Make sure that the file can be written. Raises `ShowError` if not.

        If it cannot be written later on, that is logged once.
        """
        self._file: PictureFile | VideoFile | None = open_shown_file(path)
        self._camera = camera
        self._settings = settings
        self._latest: Analysis | None = None
        self._paths: dict[int, deque[tuple[float, float, float]]] = {}
        """Time (seconds) and foot point (pixels of the working picture) by track number."""
        self._events: deque[tuple[float, Event]] = deque()
        """Time (seconds) from which an event is drawn, and the event."""
        self._lines: deque[tuple[Colour, str]] = deque(maxlen=LINES)

    def __call__(self, analysis: Analysis) -> None:
        """Take in a frame, and draw it if the file wants it."""
        if self._file is None:
            return
        self._remember(analysis)
        self._latest = analysis
        now = time.monotonic()
        try:
            if self._file.wants(analysis.t, now):
                self._file.write(analysis.t, now, self._drawn(analysis))
        except ShowError as error:
            self._fail(error)

    def close(self) -> None:
        """Write the last picture and complete the file."""
        if self._file is None or self._latest is None:
            return
        try:
            self._file.finish(self._drawn(self._latest))
        except ShowError as error:
            self._fail(error)

    def _fail(self, error: ShowError) -> None:
        """Stop drawing, and say why."""
        self._file = None  # which completes a video
        log.warning("--show: %s; it is not written any more, events go on", str(error))

    def _remember(self, analysis: Analysis) -> None:
        """Take in the paths, events and decisions of a frame. Costs little."""
        # Paths of the last seconds.
        for track in analysis.tracks:
            if track.last.t == analysis.t:
                path = self._paths.setdefault(track.number, deque())
                path.append((analysis.t, *track.last.foot))
        for number, path in list(self._paths.items()):
            while path and path[0][0] < analysis.t - PATH_SECONDS:
                path.popleft()
            if not path:
                del self._paths[number]

        # Events and decisions.
        self._events += ((analysis.t, event) for event in analysis.events)
        while self._events and self._events[0][0] < analysis.t - EVENT_SECONDS:
            self._events.popleft()
        for one in analysis.decisions:
            text = f"{clock_words(one.t)} track {one.track}: {words_of(one)}"
            self._lines.append((_REASONS.get(one.reason, _TENTATIVE), text))

    def _drawn(self, analysis: Analysis) -> Picture:
        """Return the drawn picture of a frame that was remembered last."""
        height, width = analysis.frame.shape
        factor = WIDTH / max(height, width)
        size = (round(width * factor), 2 * round(height * factor / 2))  # video needs even numbers
        picture = cv2.cvtColor(
            cv2.resize(analysis.frame, size, interpolation=cv2.INTER_LINEAR), cv2.COLOR_GRAY2BGR
        )

        # The view: areas, doors, foreground.
        _draw_areas(picture, self._settings.ignore)
        _draw_doors(picture, self._settings.doors, analysis.learned_doors, factor)
        if analysis.moving is not None:
            _draw_outline(picture, analysis.moving)

        # Detections, tracks, events.
        if analysis.detector is not None:
            _draw_detections(picture, analysis.detector, factor)
        for track in analysis.lost:
            self._draw_track(picture, track, factor, lost=True)
        for track in analysis.tracks:
            self._draw_track(picture, track, factor, lost=track.last.t < analysis.t)
        for _, event in self._events:
            _draw_event(picture, event)

        # Words.
        state = ""
        if analysis.moving is None:
            state = "  most of the picture has changed"
        if analysis.detector is not None:
            state += f"  detector {'' if analysis.detector.trusted else 'not '}trusted, "
            state += f"agreement {analysis.detector.agreement:.2f}"
        _write(picture, (6, 16), f"{self._camera}  {clock_words(analysis.t)}{state}", _WORDS)
        beside = WIDTH - size[0]
        picture = cv2.copyMakeBorder(picture, 0, 0, 0, beside, cv2.BORDER_CONSTANT, value=_GROUND)
        return cv2.vconcat([picture, self._strip()])

    def _draw_track(self, picture: Picture, track: Track, factor: float, lost: bool) -> None:
        """Draw box, number and path of a track.

        lost: it is not seen in this frame.
        """
        followed = track.confirmed and not lost
        colour = _OBJECT if followed else _TENTATIVE
        left, top, right, bottom = (round(factor * value) for value in track.last.box)
        cv2.rectangle(picture, (left, top), (right, bottom), colour, 2 if followed else 1)
        label = f"{track.number}{'' if track.confirmed else '?'}{' lost' if lost else ''}"
        _write(picture, (max(left, 0), max(top - 4, 32)), label, colour)

        path = self._paths.get(track.number, ())
        if len(path) > 1:
            feet = np.array([(x, y) for _, x, y in path]) * factor
            cv2.polylines(picture, [feet.round().astype(np.int32)], False, colour, 1, cv2.LINE_AA)

    def _strip(self) -> Picture:
        """Return the strip with the latest decisions in words, the newest at the bottom."""
        strip = np.full((LINES * LINE_PIXELS + 8, WIDTH, 3), _GROUND, np.uint8)
        for row, (colour, text) in enumerate(self._lines):
            _write(strip, (6, (row + 1) * LINE_PIXELS), text, colour)
        return strip


def _draw_areas(picture: Picture, areas: Iterable[Polygon]) -> None:
    """Darken and frame ignored areas."""
    for area in areas:
        corners = _corners(picture, area)
        dark = picture.copy()
        cv2.fillPoly(dark, [corners], _IGNORED)
        cv2.addWeighted(dark, 0.35, picture, 0.65, 0.0, picture)
        cv2.polylines(picture, [corners], True, _IGNORED, 2)


def _draw_doors(
    picture: Picture,
    named: Iterable[Polygon],
    learned: Iterable[tuple[float, float]],
    factor: float,
) -> None:
    """Draw named doors, and learned ones as circles."""
    for door in named:
        corners = _corners(picture, door)
        if len(door) == 1:
            cv2.circle(picture, _point(*corners[0]), 7, _DOOR, -1, cv2.LINE_AA)
        else:
            cv2.polylines(picture, [corners], True, _DOOR, 2)
    for x, y in learned:
        cv2.circle(picture, _point(factor * x, factor * y), 7, _DOOR, 2, cv2.LINE_AA)


def _draw_outline(picture: Picture, moving: Luma) -> None:
    """Draw the outline of the foreground, a mask of the working picture."""
    height, width = picture.shape[:2]
    mask = cv2.resize(moving, (width, height), interpolation=cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(picture, outlines, -1, _FOREGROUND, 1)


def _draw_detections(picture: Picture, result: DetectorResult, factor: float) -> None:
    """Draw what the detector has found in this frame, with scores."""
    for one in result.detections:
        left, top, right, bottom = (round(factor * value) for value in one.box)
        cv2.rectangle(picture, (left, top), (right, bottom), _DETECTION, 1)
        _write(picture, (left, bottom + 12), f"{one.label} {one.score:.2f}", _DETECTION)


def _draw_event(picture: Picture, event: Event) -> None:
    """Draw an event at its place."""
    height, width = picture.shape[:2]
    x, y = _point((event.x or 0.0) * width, (event.y or 0.0) * height)
    colour = _ENTRY if event.kind == "entry" else _EXIT
    cv2.circle(picture, (x, y), 9, colour, -1, cv2.LINE_AA)
    cv2.circle(picture, (x, y), 9, _WORDS, 1, cv2.LINE_AA)

    # Words beside it, on the side with more room.
    label = f"{event.kind} {event.track}"
    (wide, _), _ = cv2.getTextSize(label, _FONT, _FONT_SCALE, 1)
    left = x + 14 if x < width / 2 else x - 14 - wide
    _write(picture, (left, min(max(y + 4, 32), height - 6)), label, colour)


def _write(picture: Picture, at: tuple[int, int], text: str, colour: Colour) -> None:
    """Write text whose lower left corner is ``at``, on a dark ground."""
    x, y = at
    (wide, high), below = cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)
    cv2.rectangle(picture, (x - 2, y - high - 2), (x + wide + 2, y + below), _GROUND, -1)
    cv2.putText(picture, text, at, _FONT, _FONT_SCALE, colour, 1, cv2.LINE_AA)


def _corners(picture: Picture, polygon: Sequence[tuple[float, float]]) -> cv2.typing.MatLike:
    """Return the corners (N, 2) of a polygon in pixels of the drawn picture."""
    height, width = picture.shape[:2]
    return np.asarray(np.multiply(polygon, (width, height)).round(), np.int32)


def _point(x: float, y: float) -> tuple[int, int]:
    return round(x), round(y)
