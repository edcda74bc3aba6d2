"""Event time beside this machine's clock.

Event time is that of the newest event to be learned. This machine's clock is assumed to be right
(NTP): an event further ahead of it is stored and not learned, and while the clock is behind event
time nothing is taken, as one of the two is wrong. Only an observed step back of the clock takes
event time back.
"""

from __future__ import annotations

import math

from camtopod.admin import Reset, Rewind
from camtopod.event_time import MICROSECONDS, EventTime, EventTimeState, microseconds
from camtopod.serve.ingest.received import Received
from camtopod.serve.storage import Entry

STEP_SECONDS_MIN = 60.0
"""A step back of this machine's clock by more than this takes event time back."""


class EventClock:
    """Follows event time, and tells what this machine's clock means for it.

    In all methods ``wall`` is this machine's time in Unix seconds, ``now`` that of a clock that
    never steps.

    event_time: event time as the learner has it after the stored entries.
    behind_max: how far (seconds) this machine's clock may be behind event time.
    settle: how far (seconds) event time stays behind the clock when no events come.
    """

    def __init__(
        self, event_time: EventTime, behind_max: float, settle: float, wall: float, now: float
    ) -> None:
        self._event_time = event_time
        newest_us = event_time.state.newest_us
        self.newest = -math.inf if newest_us is None else newest_us / MICROSECONDS
        """Event time of the newest event to be learned, Unix seconds; -infinity if there is none.
        """
        self._behind_max = behind_max
        self._settle = settle
        self._beside = wall - now  # this machine's clock minus the steady one
        self._quiet_since = now
        self.deadline: float | None = None
        """Event time (Unix seconds) that the learner waits for; set from any thread."""

    @property
    def waited(self) -> frozenset[str]:
        """Cameras whose backlog the learner waits for, behind the newest stored entry."""
        return frozenset(self._event_time.state.waited)

    @property
    def watermark(self) -> float:
        """The learner's watermark after what is stored, Unix seconds; -infinity without one."""
        watermark_us = self._event_time.state.watermark_us
        return -math.inf if watermark_us is None else watermark_us / MICROSECONDS

    def reason(self, wall: float) -> str:
        """Return why nothing is taken, and what to do; "" if events are taken. Any thread."""
        behind = self.newest - wall
        if behind <= self._behind_max:
            return ""
        return (
            f"this machine's clock is {behind:.0f} s behind the newest event: nothing is taken, and"
            " the grabbers keep their events until the clock has passed it; set the clock if it is"
            " wrong; if it is right, `camtopod reset` begins the site anew"
        )

    def was_set_back(self, wall: float, now: float) -> bool:
        """Return True if this machine's clock was set back since the last call."""
        step = wall - now - self._beside
        self._beside = wall - now
        return step < -STEP_SECONDS_MIN

    def note_taken(self, ready: list[Received], now: float) -> None:
        """Follow the events to be learned."""
        times = [item.event.t for item in ready if item.event is not None]
        self.newest = max([self.newest, *times])
        self._quiet_since = now

    def note_quiet(self, wall: float, now: float) -> list[Received]:
        """Return an entry if event time has to follow the clock, as no events come.

        It does if the learner waits for it and the last events were of the present.
        """
        deadline, quiet = self.deadline, now - self._quiet_since
        to = wall - self._settle
        if deadline is None or quiet < self._settle or to < max(deadline, self.newest):
            return []
        if abs(self.newest - (wall - quiet)) > self._behind_max + self._settle:
            return []
        self.deadline = None  # until the learner sets another: it may take long to get here
        self.newest = to
        return [Received(Entry("advance", "", None, None, repr(to).encode()), advance=to)]

    def note_stored(self, item: Received) -> bool:
        """Follow event time as the learner does; return True if an event is late."""
        if item.event is not None:
            return not self._event_time.note(microseconds(item.event.t), item.event.camera)
        if item.waited is not None:
            self._event_time.wait_for(item.waited)
        if item.advance is not None:
            self._event_time.advance(microseconds(item.advance))
        match item.command:
            case Reset():
                self._event_time.load(EventTimeState())
            case Rewind(to):
                self._event_time.rewind(microseconds(to))
        return False
