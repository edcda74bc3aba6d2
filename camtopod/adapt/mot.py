"""MOTChallenge text files -> events: a line for each box,
``frame,id,left,top,width,height,confidence,...``.
"""

from __future__ import annotations

import math
from array import array

import numpy as np

from camtopod import codec
from camtopod.adapt.adapter import Size, checked
from camtopod.adapt.tracks import TrackEvents
from camtopod.codec import Rejected
from camtopod.records import Event

ROWS_MAX = 5_000_000
"""Boxes of a file, 48 bytes each; further ones are refused."""
_FIELDS_MIN = 6
_CONFIDENCE = 6


class Mot:
    """Reads one camera's file; the events come with `close`, by time: ground truth is sorted by
    track, not by frame.

    Frame 1 is at ``start``, Unix seconds. A confidence of exactly 0 marks what does not count in
    ground truth; boxes with a negative id belong to no track. Neither is an error, nor an event.
    """

    topic = ""

    def __init__(self, camera: str, size: Size, fps: float, start: float) -> None:
        """``fps``: frames a second. Raises `ValueError` where one of these makes no sense."""
        if not 0 < fps < math.inf:
            raise ValueError("the frames a second are a number above 0")
        if not math.isfinite(start):
            raise ValueError("the start is a number of seconds")
        self._tracks = TrackEvents(camera, size)
        self._fps, self._start = fps, start
        self._rows = array("d")

    def receive(self, line: bytes) -> list[Event]:
        """Keep a box. Raises `Rejected`."""
        fields = line.replace(b",", b" ").split()
        if len(fields) < _FIELDS_MIN:
            raise Rejected(
                "malformed", f"{len(fields)} fields; frame,id,left,top,width,height,... are needed"
            )
        try:
            numbers = [float(field) for field in fields[: _CONFIDENCE + 1]]
        except ValueError:
            raise Rejected(
                "malformed", "not a number among frame,id,left,top,width,height,confidence"
            ) from None
        frame, track, left, top, width, height = numbers[:_FIELDS_MIN]
        if not all(map(math.isfinite, numbers)) or frame < 0 or width < 0 or height < 0:
            raise Rejected(
                "bad-value", "a frame, a width or a height below 0, or not a finite number"
            )
        if not codec.T_MIN <= self._time(frame) < codec.T_MAX:
            raise Rejected("bad-value", f"frame {frame:g} is at no time between 1970 and 3000")
        if len(self._rows) >= ROWS_MAX * _FIELDS_MIN:
            raise Rejected("too-many", f"more than {ROWS_MAX} boxes")
        if track >= 0 and numbers[_CONFIDENCE:] != [0.0]:
            self._rows.extend((frame, track, left, top, left + width, top + height))
        return []

    def close(self) -> list[Event]:
        """The events of the whole file."""
        rows = np.frombuffer(self._rows).reshape(-1, _FIELDS_MIN)
        rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
        frames, starts = np.unique(rows[:, 0], return_index=True)
        events = self._tracks.update([], [], self._time(frames.min(initial=1.0)))
        for frame, first, end in zip(frames, starts, [*starts[1:], len(rows)], strict=False):
            events += self._tracks.update(
                rows[first:end, 1], rows[first:end, 2:], self._time(frame)
            )
        return sorted(checked(events + self._tracks.close()), key=lambda event: event.t)

    def _time(self, frame: float) -> float:
        return self._start + (frame - 1) / self._fps
