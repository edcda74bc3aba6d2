"""Makes a `Decision` where the tracker or the crossings decide, if somebody asks for it."""

from __future__ import annotations

from collections.abc import Callable

from camtopod.vision.track.decisions import Decision, Edge, Reason
from camtopod.vision.track.track import Sighting, Track


class Recorder:
    """Passes decisions on to ``take``; without it, it does nothing."""

    def __init__(
        self, size: tuple[int, int] = (1, 1), take: Callable[[Decision], None] | None = None
    ) -> None:
        """Prepare for a working image of ``size`` (width, height), pixels."""
        self._size = size
        self._take = take

    def note(
        self,
        reason: Reason,
        track: Track,
        at: Sighting,
        edge: Edge | None = None,
        value: float = 0.0,
        least: float = 0.0,
        other: int = 0,
    ) -> None:
        """Record what the beginning or end of ``track`` at a sighting was taken for."""
        if self._take is None:
            return
        width, height = self._size
        x, y = at.foot[0] / width, at.foot[1] / height
        place = min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0)
        self._take(
            Decision(
                reason,
                track.number,
                at.t,
                place,
                track.first.t,
                edge,
                value,
                least,
                track.sightings,
                other,
            )
        )
