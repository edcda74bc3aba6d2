"""Notice a tracker that breaks tracks up: one passage then counts as several."""

from __future__ import annotations

import math
from collections import deque

from msgspec import Struct, field

from camtopod.records import Event

BORDER = 0.1
"""Nearer to a border than this an entry is no surprise, fractions of the picture."""
GAP_SECONDS = 2.0
"""Longest time from the end of a track to the beginning of its continuation."""
OVERLAP_SECONDS = 0.5
"""A continuation may begin this much before the end of the track."""
NEAR = 0.15
"""Longest distance from the end of a track to its continuation, fractions of the picture."""
ENTRIES_MIN = 20
"""Entries of a camera before its tracker is judged."""
SHARE_MIN = 0.3
"""Share of the entries that continue another track, from which on a tracker fragments."""
CAMERAS_MAX = 1000
"""Cameras judged, the first ones."""
_KEPT = 100
"""Ends and beginnings of a camera kept to be compared."""


class _Camera(Struct):
    """A camera's counts, and its latest ends and beginnings in mid-view that have no match."""

    entries: int = 0
    fragments: int = 0
    warned: bool = False
    ends: deque[Event] = field(default_factory=lambda: deque(maxlen=_KEPT))
    begins: deque[Event] = field(default_factory=lambda: deque(maxlen=_KEPT))


class Fragmentation:
    """Counts entries in mid-view that begin soon after and near the end of another track.

    Exits may come before or after the entries that they belong to.
    """

    def __init__(self) -> None:
        self._cameras: dict[str, _Camera] = {}

    def note(self, event: Event) -> str | None:
        """Count an event; return a warning, once for each camera whose tracks break up."""
        camera = self._cameras.get(event.camera)
        if camera is None:
            if len(self._cameras) >= CAMERAS_MAX:
                return None
            camera = self._cameras[event.camera] = _Camera()
        camera.entries += event.kind == "entry"

        # Events in mid-view are matched, or kept for one to come.
        if _in_mid_view(event):
            others = camera.ends
            own = camera.begins
            if event.kind == "exit":
                others, own = own, others
            match = next((other for other in others if _continues(event, other)), None)
            if match is None:
                own.append(event)
            else:
                others.remove(match)
                camera.fragments += 1

        # Judge.
        if (
            camera.warned
            or camera.entries < ENTRIES_MIN
            or camera.fragments < SHARE_MIN * camera.entries
        ):
            return None
        camera.warned = True
        return (
            f"camera {event.camera}: {camera.fragments} of {camera.entries} entries begin in "
            f"mid-view, within {GAP_SECONDS:g} s and near the end of another track. Its tracker "
            f"breaks tracks up, so one passage counts as several, and wrong zones are learned. "
            f"Have the tracker keep lost tracks longer (track_buffer, max_age, "
            f"maxShadowTrackingAge), lower its detection threshold, or give it more frames per "
            f"second"
        )


def _in_mid_view(event: Event) -> bool:
    return (
        event.x is not None
        and event.y is not None
        and BORDER <= event.x <= 1 - BORDER
        and BORDER <= event.y <= 1 - BORDER
    )


def _continues(event: Event, other: Event) -> bool:
    """Return True if the entry of the two may continue the track of the exit."""
    entry, end = (event, other) if event.kind == "entry" else (other, event)
    if entry.x is None or entry.y is None or end.x is None or end.y is None:
        return False
    return (
        entry.track != end.track
        and -OVERLAP_SECONDS <= entry.t - end.t <= GAP_SECONDS
        and math.dist((entry.x, entry.y), (end.x, end.y)) <= NEAR
    )
