"""Which cameras the learner waits for: those that deliver a backlog, and get on with it.

When the daemon or the network was away, every spool delivers its backlog, some sooner than others.
Each event is stored as it comes. But if the learner's time went on with the first backlog, the
cameras whose backlogs are still to come would look silent, and the passages between them unseen.
So the learner's watermark waits for cameras with older events to deliver
(`camtopod.event_time.EventTime.wait_for`). The journal names them, so that a replay waits for the
same.

A camera that gains less than a second a second on the clock, or needs more than an hour for its
backlog, is waited for no longer: its events are late, and are learned all the same. So are those of
a camera that has been away alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

from msgspec import Struct

from camtopod import codec
from camtopod.serve.ingest.cameras import CameraIntake
from camtopod.serve.ingest.event_clock import EventClock
from camtopod.serve.ingest.received import Received
from camtopod.serve.storage import Entry

SETTLE_SECONDS = 5.0
"""Time that other cameras get to tell of their backlogs: after the start, and after each that did.

A backlog may be a single batch, as after an outage of a minute.
"""
UNSETTLED_SECONDS_MAX = 30.0
"""Longest time for all of them together: on a large site, some camera may always come back."""
TRIAL_SECONDS = 60.0
"""Time in which a camera has to come as much nearer to the clock."""
BACKLOG_SECONDS_MAX = 3600.0
"""Longest time that a camera may need for all of its backlog, as fast as in the last trial."""
ANY_CAMERA = ""
"""Stands for cameras that have not told of their backlogs yet."""


class Trial(Struct):
    """A camera that is waited for.

    since: when this trial began, by the steady clock.
    behind (seconds): distance of its newest event to this machine's clock at that time.
    """

    since: float
    behind: float


class Backlogs:
    """Decides which cameras the learner waits for; used by one thread.

    In all methods ``wall`` is this machine's time in Unix seconds, ``now`` that of a clock that
    never steps.

    lateness: the learner's (seconds). An event older than this is of a backlog.
    """

    def __init__(self, lateness: float, event_clock: EventClock, now: float) -> None:
        self._lateness = lateness
        self._event_clock = event_clock
        self._deadline = now + SETTLE_SECONDS
        self._trials: dict[str, tuple[CameraIntake, Trial]] = {}
        self._unsettled_since = now
        self.waited_cameras = event_clock.waited
        """Cameras that the learner was last told to wait for."""

    def note_request(
        self, camera: CameraIntake, oldest: float | None, wall: float, now: float
    ) -> None:
        """Note that a batch of a camera has come.

        oldest: time of its first event, Unix seconds; None without events.
        """
        if oldest is not None:
            is_first, camera.is_new = camera.is_new, False
        if camera.reached < self._event_clock.watermark:
            return
        if oldest is not None and is_first and wall - oldest > self._lateness:
            if ANY_CAMERA not in self.waited_cameras:
                self._unsettled_since = now
            until = min(now + SETTLE_SECONDS, self._unsettled_since + UNSETTLED_SECONDS_MAX)
            self._deadline = max(self._deadline, until)
        if camera.more and wall - camera.reached > self._lateness:
            self._trials.setdefault(camera.name, (camera, Trial(now, wall - camera.reached)))

    def changed(
        self,
        wall: float,
        now: float,
        present: Callable[[Iterable[str]], set[str]],
        is_asking: Callable[[str], bool],
        alive: Collection[str] = (),
    ) -> list[Received]:
        """Return the entry that tells the learner which cameras to wait for, if that has changed.

        present: returns the present names of cameras, without forgotten ones.
        is_asking: returns True if a request of a camera has come and is not taken yet.
        alive: cameras whose grabber is on the bus: with a backlog, it may be slow to ask.
        """
        for name, (camera, trial) in list(self._trials.items()):
            is_held = camera.pending is not None or is_asking(name)
            is_held |= bool(camera.more) and name in alive
            if not self._is_waited_for(camera, trial, is_held, wall, now):
                del self._trials[name]
        cameras = frozenset([*present(self._trials), *[ANY_CAMERA][: now < self._deadline]])
        if cameras == self.waited_cameras:
            return []
        self.waited_cameras = cameras
        raw = codec.to_json(sorted(cameras))
        return [Received(Entry("waits", "", None, None, raw), waited=cameras)]

    def _is_waited_for(
        self, camera: CameraIntake, trial: Trial, is_held: bool, wall: float, now: float
    ) -> bool:
        """Return True if a camera has older events to deliver, and delivers them fast enough.

        is_held: a request of it waits for the daemon, or is sure to come.
        """
        behind = wall - camera.reached
        if behind <= self._lateness or camera.reached < self._event_clock.watermark:
            return False
        if not is_held and (not camera.more or now - camera.asked > SETTLE_SECONDS):
            return False
        if now - trial.since < TRIAL_SECONDS:
            return True
        gain = trial.behind - behind
        trial.since, trial.behind = now, behind
        return gain >= TRIAL_SECONDS * max(1.0, behind / BACKLOG_SECONDS_MAX)
