"""Event time: how far the events of a site have come, and which of them are too late to be learned.

Event time is where a second camera has come to, so that a single camera whose clock is ahead does
not make other cameras' events late; but it is at most ``apart`` behind the first, so that silent
cameras hold nothing up. The watermark trails event time by the lateness. A camera whose events are
mostly late, but by no more than ``apart``, has a clock that is behind: from then on the watermark
waits for it.
"""

from __future__ import annotations

from collections.abc import Set

from msgspec import Struct

BEHIND_EVENTS = 20
"""Of so many events in a row, most have to be late to tell of a clock that is behind."""


MICROSECONDS = 1_000_000


def microseconds(t: float) -> int:
    """Event time as an integer, so that equal times are equal and sums can be undone."""
    return round(t * MICROSECONDS)


class Behind(Struct):
    """How far one camera's events come behind event time, in microseconds."""

    known: int = 0
    """The most that one of the last `BEHIND_EVENTS` was behind; 0 when most of them were not
    late.
    """
    events: int = 0
    """Since then, ..."""
    late: int = 0
    """... how many of these were late, ..."""
    most: int = 0
    """... and the most that one of them was behind."""

    def note(self, behind_us: int, lateness_us: int) -> None:
        """One more event."""
        self.events += 1
        self.late += behind_us > lateness_us
        self.most = max(self.most, behind_us)
        if self.events == BEHIND_EVENTS:
            self.known = self.most if 2 * self.late > BEHIND_EVENTS else 0
            self.events = self.late = self.most = 0


class EventTimeState(Struct):
    """What an `EventTime` knows."""

    newest_us: int | None = None
    second_us: int | None = None
    leader: str | None = None
    watermark_us: int | None = None
    behind: dict[str, Behind] = {}


class EventTime:
    """How far event time has come, and which events are too late for it. All times in
    microseconds.
    """

    def __init__(self, lateness_seconds: float, clocks_apart_seconds: float = 0.0) -> None:
        self._lateness_us, self._apart_us = (
            microseconds(lateness_seconds),
            microseconds(clocks_apart_seconds),
        )
        self.newest_us: int | None = None
        self.watermark_us: int | None = None
        """Nothing older will be learned any more; None before the first event."""
        self.second_us: int | None = None
        """The newest of another camera than the one that has come furthest ..."""
        self.leader: str | None = None
        """... which is this one."""
        self.behind: dict[str, Behind] = {}
        self.lateness_us = self._lateness_us
        """By how much the watermark trails event time: the setting, and the clock that is furthest
        behind.
        """

    def note(self, t_us: int, camera: str) -> bool:
        """A camera has an event at ``t_us``; False if that is too late to be learned."""
        self._look_behind(t_us, camera)
        if self.watermark_us is not None and t_us < self.watermark_us:
            return False
        if self.newest_us is None or t_us > self.newest_us:
            if camera != self.leader:
                self.second_us, self.leader = self.newest_us, camera
            self.newest_us = t_us
        elif camera != self.leader and (self.second_us is None or t_us > self.second_us):
            self.second_us = t_us
        self._raise_watermark()
        return True

    def advance(self, now_us: int) -> None:
        """Event time has come to ``now`` although no event says so."""
        if self.newest_us is not None and now_us > self.newest_us:
            self.newest_us = self.second_us = now_us
            self.leader = None
            self._raise_watermark()

    def rewind(self, to_us: int) -> None:
        """What was later than ``to`` was stamped by a wrong clock: from there on events are learned
        again.
        """
        if self.watermark_us is not None and self.watermark_us > to_us:
            self.newest_us = self.second_us = to_us + self.lateness_us
            self.leader, self.watermark_us = None, to_us

    def save(self) -> EventTimeState:
        """Everything `load` needs to go on from here."""
        return EventTimeState(
            self.newest_us, self.second_us, self.leader, self.watermark_us, self.behind
        )

    def load(self, state: EventTimeState) -> None:
        """Go on from there."""
        self.newest_us, self.second_us, self.leader = state.newest_us, state.second_us, state.leader
        self.watermark_us, self.behind = state.watermark_us, state.behind
        self._wait_for_the_last()

    def forget(self, names: Set[str]) -> None:
        """Forget what is known of the clocks of these cameras."""
        for name in names & self.behind.keys():
            del self.behind[name]
        self._wait_for_the_last()

    def _look_behind(self, t_us: int, camera: str) -> None:
        """How far an event is behind event time; one that is further than clocks may be apart tells
        of no clock.
        """
        come = self._come_to()
        if come is None or come - t_us > self._apart_us:
            return
        behind = self.behind.setdefault(camera, Behind())
        known = behind.known
        behind.note(come - t_us, self._lateness_us)
        if behind.known != known:
            self._wait_for_the_last()

    def _wait_for_the_last(self) -> None:
        self.lateness_us = self._lateness_us + max(
            (behind.known for behind in self.behind.values()), default=0
        )

    def _come_to(self) -> int | None:
        """Event time."""
        if self.newest_us is None:
            return None
        second = self.newest_us if self.second_us is None else self.second_us
        return max(second, self.newest_us - self._apart_us)

    def _raise_watermark(self) -> None:
        """It rises only, except in `rewind`: what has been passed has been learned."""
        come = self._come_to()
        assert come is not None
        watermark = come - self.lateness_us
        if self.watermark_us is None or watermark > self.watermark_us:
            self.watermark_us = watermark
