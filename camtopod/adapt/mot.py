"""Events from MOTChallenge text files: a line per box, ``frame,id,left,top,width,height,...``."""

from __future__ import annotations

import math
from array import array

import numpy as np

from camtopod import codec
from camtopod.adapt.adapter import ANY_CAMERA, OUTSIDE_MAX, Adapter, Sizes
from camtopod.adapt.tracks import TrackEvents
from camtopod.codec import Rejected
from camtopod.records import Event

_AI_CITY = (
    "is of the AI City Challenge (camera, id, frame, left, top, width, height, ...), not of "
    "MOTChallenge: take one camera's with awk '$1 == CAMERA {print $3, $2, $4, $5, $6, $7}'"
)
ROWS_MAX = 5_000_000
"""Boxes accepted from a file, 48 bytes each."""


class Mot(Adapter):
    """Adapter for the file of one camera.

    All events come from `close`, ordered by time, because ground truth files are sorted by track
    rather than by frame. Frame 1 is at ``start`` (seconds since the epoch). Boxes with a confidence
    of exactly 0, which ground truth marks as not counting, and boxes with a negative id, which
    belong to no track, are ignored without an error.
    """

    begins = b""
    box_form = "left, top, width, height in pixels"

    def __init__(self, camera: str | None, sizes: Sizes, fps: float | None, start: float) -> None:
        """Prepare for a file of ``fps`` frames per second. Raises `ValueError`."""
        size = sizes.get(camera or "") or sizes.get(ANY_CAMERA)
        super().__init__()
        if camera is None or size is None or fps is None:
            raise ValueError("mot needs --camera, --fps, and --size of that camera")
        if not 0 < fps < math.inf:
            raise ValueError("--fps must be a number above 0")
        if not math.isfinite(start):
            raise ValueError("--start must be a finite number of seconds")
        self._tracks = TrackEvents(camera, size, outside_max=OUTSIDE_MAX)
        self._fps = fps
        self._start = start
        self._rows = array("d")
        self._void_boxes = 0

    def receive(self, line: bytes) -> list[Event]:
        """Store a box. Raises `Rejected`."""
        fields = line.replace(b",", b" ").split()
        try:
            numbers = [float(field) for field in fields[:7]]
            frame, track, left, top, width, height, *confidence = numbers
        except ValueError:
            if len(fields) == 9:  # c041, ...
                raise Rejected("other-format", _AI_CITY) from None
            raise Rejected("malformed", "is not frame,id,left,top,width,height,...") from None

        # Validate. The seventh of nine columns of a ground truth is 0 or 1.
        if len(fields) == 9 and confidence > [1.0]:
            raise Rejected("other-format", _AI_CITY)
        if not all(map(math.isfinite, numbers)) or frame < 0 or width < 0 or height < 0:
            raise Rejected(
                "bad-value", "a frame, a width or a height below 0, or not a finite number"
            )
        if not codec.T_MIN <= self._time(frame) < codec.T_MAX:
            raise Rejected("bad-value", f"the time of frame {frame:g} is not between 1970 and 3000")
        if len(self._rows) >= 6 * ROWS_MAX:
            raise Rejected("too-many", f"more than {ROWS_MAX} boxes")

        # Store, unless ignored.
        if track >= 0 and confidence != [0.0]:
            self._rows.extend((frame, track, left, top, left + width, top + height))
        else:
            self._void_boxes += 1
        return []

    def close(self) -> list[Event]:
        """Return the events of the whole file."""
        rows = np.frombuffer(self._rows).reshape(-1, 6)
        rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
        frames, starts = np.unique(rows[:, 0], return_index=True)
        events = self._tracks.update([], [], self._time(frames.min(initial=1.0)))
        for frame, first, end in zip(frames, starts, [*starts[1:], len(rows)], strict=False):
            events += self._tracks.update(
                rows[first:end, 1], rows[first:end, 2:], self._time(frame)
            )
        events += self._tracks.close()
        self._check_boxes(self._tracks.camera, self._tracks.statistics(), is_end=True)
        if self._void_boxes and not len(rows):
            self.boxes_unused = self._void_boxes
            self._note(
                "", f"{self._void_boxes} boxes have a negative id or confidence 0: none is used"
            )
        if self._tracks.is_misread:
            self.boxes_used, self.boxes_unused = 0, len(rows)
            self._note("", f"the boxes are not {self.box_form}: none is used")
            return []
        return sorted(events, key=lambda event: event.t)

    def _time(self, frame: float) -> float:
        return self._start + (frame - 1) / self._fps
