"""Event time and watermark: how far a site's events have advanced, and which of them are late.

Event time is the newest event of the second most advanced camera, so that a single camera with a
fast clock does not make other cameras' events late. It is at most ``apart`` (the largest expected
difference of two clocks) behind the most advanced camera, so that silent cameras delay nothing. The
watermark trails event time by the lateness, and waits for cameras that deliver a backlog
(`EventTime.wait_for`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Set
from datetime import UTC, datetime

import numpy as np
from msgspec import Struct

MICROSECONDS = 1_000_000
_ZONE = re.compile(r" *(?:UTC|GMT|Z)\Z")


def microseconds(t: float) -> int:
    """Return seconds as integer microseconds, so that equal times are equal and sums are exact."""
    return round(t * MICROSECONDS)


def seconds_of_text(text: str) -> float:
    """Return seconds since 1970 of ISO 8601, which is UTC if it has no zone; raise `ValueError`."""
    moment = datetime.fromisoformat(_ZONE.sub("+00:00", text.strip()).replace("/", "-"))
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def utc_text(t: float) -> str:
    """Return Unix seconds as date and time of day, UTC, as in the log."""
    return f"{np.datetime64(round(t), 's')}Z"


class EventTimeState(Struct):
    """The state of an `EventTime`. All times are in microseconds."""

    newest_us: int | None = None
    """Time of the newest event, or the time passed to `EventTime.advance` if that is newer."""
    second_us: int | None = None
    """Time of the newest event of any camera other than ``leader``."""
    leader: str | None = None
    """The camera with the newest event; None after `EventTime.advance` or `EventTime.rewind`."""
    watermark_us: int | None = None
    """Events older than this are late; None before the first event."""
    waited: dict[str, int | None] = {}
    """Cameras that the watermark waits for, with the time of the newest event of each."""


class EventTime:
    """Event time and watermark of a site. All times are in microseconds.

    lateness_seconds: by how much the watermark trails event time.
    clocks_apart_seconds: the largest expected difference of two cameras' clocks.
    """

    def __init__(self, lateness_seconds: float, clocks_apart_seconds: float = 0.0) -> None:
        self.lateness_us = microseconds(lateness_seconds)
        self._apart_us = microseconds(clocks_apart_seconds)
        self._slowest = ""  # the camera that the watermark had to wait for last
        self.load(EventTimeState())

    def load(self, state: EventTimeState) -> None:
        """Continue from a state, which is changed from here on."""
        self.state = state

    def note(self, t_us: int, camera: str) -> bool:
        """Note an event of ``camera`` at ``t_us``; return False if it is late."""
        state = self.state
        if camera in state.waited:
            state.waited[camera] = max(t_us, state.waited[camera] or t_us)
        if state.watermark_us is not None and t_us < state.watermark_us:
            return False

        # Update the newest event of all cameras and that of all but the leading one.
        if state.newest_us is None or t_us > state.newest_us:
            if camera != state.leader:
                state.second_us = state.newest_us
                state.leader = camera
            state.newest_us = t_us
        elif camera != state.leader and (state.second_us is None or t_us > state.second_us):
            state.second_us = t_us

        self._raise_watermark()
        return True

    def wait_for(self, cameras: Set[str]) -> None:
        """Wait for these cameras and no others: the watermark does not pass their newest events.

        It stays where it is until each of them has sent an event.
        """
        waited = self.state.waited
        self.state.waited = {camera: waited.get(camera) for camera in sorted(cameras)}
        if self.state.newest_us is not None:
            self._raise_watermark()

    def advance(self, now_us: int) -> None:
        """Advance event time to ``now_us`` without an event; do nothing before the first event."""
        state = self.state
        if state.newest_us is not None and now_us > state.newest_us:
            state.newest_us = state.second_us = now_us
            state.leader = None
            self._raise_watermark()

    def rewind(self, to_us: int) -> None:
        """Move event time and watermark back to ``to_us``; wait for no camera.

        Events from then on are learned again. Needed when a wrong clock has stamped events later
        than that.
        """
        state = self.state
        state.waited = {}
        event_us, most_us = self._event_time(), to_us + self.lateness_us
        if event_us is not None and state.newest_us is not None and state.newest_us > most_us:
            state.newest_us = most_us
            state.second_us = min(event_us, most_us)
            state.leader = None
            if state.watermark_us is not None:
                state.watermark_us = min(state.watermark_us, to_us)

    def _event_time(self) -> int | None:
        """Return the event time."""
        newest = self.state.newest_us
        if newest is None:
            return None
        second = self.state.second_us
        if second is None:
            return newest
        return max(second, newest - self._apart_us)

    def _raise_watermark(self) -> None:
        """Raise the watermark; only `rewind` lowers it."""
        event_us = self._event_time()
        assert event_us is not None
        before_us = -math.inf if self.state.watermark_us is None else self.state.watermark_us
        watermark_us = event_us - self.lateness_us
        if waited := self.state.waited:
            if self._time_of(self._slowest) <= before_us:
                return  # it waits on
            self._slowest = min(waited, key=self._time_of)
            camera_us = waited[self._slowest]
            if camera_us is None:
                return
            watermark_us = min(watermark_us, camera_us)
        if watermark_us > before_us:
            self.state.watermark_us = watermark_us

    def _time_of(self, camera: str) -> float:
        """Return the time of a camera that is waited for; -infinity if it has sent no event."""
        t_us = self.state.waited.get(camera, math.inf)
        return -math.inf if t_us is None else t_us
