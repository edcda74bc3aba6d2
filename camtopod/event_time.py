"""Event time and watermark: how far a site's events have advanced, and which of them are too late.

Event time is the newest event of the second most advanced camera, so that a single camera with a
fast clock does not make other cameras' events late. It is at most ``apart`` (the largest expected
difference of two clocks) behind the most advanced camera, so that silent cameras delay nothing. The
watermark trails event time by the lateness. If most events of a camera are late, but by no more
than ``apart``, its clock is slow, and from then on the watermark waits for it.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np
from msgspec import Struct

BEHIND_EVENTS = 20
"""Consecutive events of a camera after which `CameraDelay` decides whether its clock is slow."""


MICROSECONDS = 1_000_000


def microseconds(t: float) -> int:
    """Return seconds as integer microseconds, so that equal times are equal and sums are exact."""
    return round(t * MICROSECONDS)


def utc_text(t: float) -> str:
    """Return Unix seconds as date and time of day, UTC, as in the log."""
    return f"{np.datetime64(round(t), 's')}Z"


class CameraDelay(Struct):
    """How far the events of one camera are behind event time, in microseconds."""

    known: int = 0
    """Largest delay in the last complete block of `BEHIND_EVENTS`; 0 if at most half were late."""
    events: int = 0
    """Events in the current block."""
    late: int = 0
    """Events in the current block that were later than the lateness allows."""
    most: int = 0
    """Largest delay in the current block."""

    def note(self, behind_us: int, lateness_us: int) -> None:
        """Count one more event, ``behind_us`` behind event time."""
        self.events += 1
        self.late += behind_us > lateness_us
        self.most = max(self.most, behind_us)

        # At the end of a block, decide and start the next one.
        if self.events == BEHIND_EVENTS:
            self.known = self.most if 2 * self.late > BEHIND_EVENTS else 0
            self.events = self.late = self.most = 0


class EventTimeState(Struct):
    """The state of an `EventTime`. All times are in microseconds."""

    newest_us: int | None = None
    """Time of the newest event, or the time passed to `EventTime.advance` if that is newer."""
    second_us: int | None = None
    """Time of the newest event of any camera other than ``leader``."""
    leader: str | None = None
    """The camera with the newest event; None after `EventTime.advance` or `EventTime.rewind`."""
    watermark_us: int | None = None
    """Events older than this are too late to be learned; None before the first event."""
    behind: dict[str, CameraDelay] = {}
    """How far the events of each camera are behind."""


class EventTime:
    """Event time and watermark of a site. All times are in microseconds.

    lateness_seconds: by how much the watermark trails event time at least.
    clocks_apart_seconds: the largest expected difference of two cameras' clocks.
    """

    def __init__(self, lateness_seconds: float, clocks_apart_seconds: float = 0.0) -> None:
        self._lateness_us = microseconds(lateness_seconds)
        self._apart_us = microseconds(clocks_apart_seconds)
        self.load(EventTimeState())

    def load(self, state: EventTimeState) -> None:
        """Continue from a state, which is changed from here on."""
        self.state = state
        self._update_lateness()

    def note(self, t_us: int, camera: str) -> bool:
        """Note an event of ``camera`` at ``t_us``; return False if it is too late to be learned."""
        self._update_delay(t_us, camera)
        state = self.state
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

    def advance(self, now_us: int) -> None:
        """Advance event time to ``now_us`` without an event; do nothing before the first event."""
        state = self.state
        if state.newest_us is not None and now_us > state.newest_us:
            state.newest_us = state.second_us = now_us
            state.leader = None
            self._raise_watermark()

    def rewind(self, to_us: int) -> None:
        """Move the watermark back to ``to_us``, so that events from then on are learned again.

        Needed when a wrong clock has stamped events later than that.
        """
        state = self.state
        if state.watermark_us is not None and state.watermark_us > to_us:
            state.newest_us = state.second_us = to_us + self.lateness_us
            state.leader = None
            state.watermark_us = to_us

    def forget(self, names: Set[str]) -> None:
        """Forget the delays of these cameras."""
        for name in names & self.state.behind.keys():
            del self.state.behind[name]
        self._update_lateness()

    def rename(self, old: str, new: str) -> None:
        """Continue with the camera ``old`` under the name ``new``."""
        if old in self.state.behind:
            self.state.behind[new] = self.state.behind.pop(old)
        if self.state.leader == old:
            self.state.leader = new

    def _update_delay(self, t_us: int, camera: str) -> None:
        """Update the camera's delay; ignore events further behind than clocks may differ."""
        come = self._event_time()
        if come is None or come - t_us > self._apart_us:
            return
        behind = self.state.behind.setdefault(camera, CameraDelay())
        known = behind.known
        behind.note(come - t_us, self._lateness_us)
        if behind.known != known:
            self._update_lateness()

    def _update_lateness(self) -> None:
        """Update ``lateness_us``: the setting plus the delay of the slowest camera."""
        delays = (behind.known for behind in self.state.behind.values())
        self.lateness_us = self._lateness_us + max(delays, default=0)

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
        """Raise the watermark; only `rewind` lowers it, as events below it have been learned."""
        come = self._event_time()
        assert come is not None
        watermark = come - self.lateness_us
        if self.state.watermark_us is None or watermark > self.state.watermark_us:
            self.state.watermark_us = watermark
