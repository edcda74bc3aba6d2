"""Statuses of the daemon and of grabbers; the fields say which metric they are."""

from __future__ import annotations

from typing import Annotated

from msgspec import Struct

from camtopod.records.field_types import SiteName, metric
from camtopod.records.topology import Alarm, SelfScore


class Status(Struct, frozen=True):
    """State of the daemon or of the program that publishes a camera's events.

    state: running or degraded for the daemon; connecting, running, stalled, failed and others for
        a camera.
    reason: why it is not running as it should; empty if it is.
    t (Unix seconds): when the status was made.
    camera: the camera; the daemon's status has none.
    status_seconds: interval at which the status is published; None: it does not say.

    Counters and other fields follow; which ones, and what they mean, may change.
    """

    state: str = ""
    reason: str = ""
    t: float = 0.0
    camera: str | None = None
    status_seconds: float | None = None


class GrabberStatus(Status, frozen=True):
    """State of a grabber, as published on ``status/{camera}``; None: it does not say.

    sites: all sites to which it delivers.
    owner: the one that owns the camera. Of events, ``waiting`` and ``dropped`` are those of the
        site on whose bus the status is.
    """

    sites: list[SiteName] = []
    owner: SiteName | None = None

    restarts: Annotated[
        int | None, metric("grabber_restarts_total", "Restarts of the camera's process")
    ] = None
    failures: Annotated[
        int | None, metric("grabber_failures_total", "Connections that failed or were lost")
    ] = None
    frames_analysed: Annotated[
        int | None, metric("grabber_frames_analysed_total", "Frames analysed")
    ] = None
    last_frame_t: Annotated[
        float | None,
        metric("grabber_frame_timestamp_seconds", "Capture time of the latest frame"),
    ] = None
    waiting: Annotated[
        int | None, metric("spool_events", "Events that the daemon has not stored yet")
    ] = None
    dropped: Annotated[
        int | None, metric("spool_dropped_total", "Events lost because the spool was full")
    ] = None
    damaged_files: Annotated[
        int | None, metric("spool_damaged_files", "Files of the spool set aside for damage")
    ] = None


class CameraFigures(Struct, frozen=True):
    """A camera in the daemon's status; ``ahead`` is None if it is unknown."""

    events: Annotated[
        int, metric("events_total", "Events taken from the camera since the start")
    ] = 0
    newest: Annotated[
        float | None, metric("event_timestamp_seconds", "Time of the camera's newest event")
    ] = None
    ahead: Annotated[
        float | None,
        metric("clock_ahead_seconds", "Last event's time ahead of this machine's clock"),
    ] = None
    alive: Annotated[
        bool, metric("camera_alive", "1 while the publisher of the camera's events is on the bus")
    ] = False


class EventCounts(Struct, frozen=True):
    """Events since the daemon's start by what became of them, and those that wait."""

    received: int = 0
    stored: Annotated[int, metric("events_stored_total", "Events stored in the journal")] = 0
    duplicate: Annotated[int, metric("events_duplicate_total", "Events received again")] = 0
    future: Annotated[
        int, metric("events_future_total", "Events too far ahead of the clock, set aside")
    ] = 0
    flood: Annotated[
        int, metric("events_flood_total", "Events beyond what one view can show, not learned")
    ] = 0
    late: int = 0
    lost: Annotated[int, metric("events_lost_total", "Events missing between others")] = 0
    waiting: Annotated[int, metric("events_waiting", "Events stored and not learned yet")] = 0


class LearnerCounts(Struct, frozen=True):
    """The learner's counts in this epoch, and sizes, as of its last step.

    labels_left_out: labels beyond the most frequent, which count as none.
    """

    accepted: int = 0
    duplicate: int = 0
    late: Annotated[int, metric("events_late_total", "Events that came later than others")] = 0
    refused: int = 0
    surplus: int = 0
    held: Annotated[
        int, metric("learner_held_events", "Events held until the watermark has passed them")
    ] = 0
    learned: int = 0
    window: int = 0
    cameras: int = 0
    watermark: Annotated[
        float | None,
        metric("watermark_timestamp_seconds", "Event time up to which everything is learned"),
    ] = None
    version: int = 0
    labels_left_out: int = 0


class CatchingUp(Struct, frozen=True):
    """How far the learner is behind.

    seconds: event time that is stored and not learned yet.
    share: events learned, of those stored since it was up to date.
    """

    seconds: float = 0.0
    share: float = 0.0


class NamesStatus(Struct, frozen=True):
    """Forgotten and renamed cameras.

    forgotten: forgotten names -> events refused since the start.
    renamed: old names -> present names.
    reset (Unix seconds): when the site was reset; None if it never was.
    before_reset: refused events from before that.
    """

    forgotten: dict[str, int] = {}
    renamed: dict[str, str] = {}
    reset: float | None = None
    before_reset: int = 0


class JournalStatus(Struct, frozen=True):
    """The journal."""

    entries: int = 0
    missing: Annotated[
        int, metric("journal_missing_entries", "Entries it had lost when it was opened")
    ] = 0
    damaged: Annotated[int, metric("journal_damaged_entries", "Damaged entries, not learned")] = 0
    bytes: Annotated[int, metric("journal_bytes", "Size of the journal's file")] = 0
    damaged_files: Annotated[
        list[str], metric("journal_damaged_files", "Files set aside for damage")
    ] = []


class BetweenPair(Struct, frozen=True, rename={"from_": "from"}):
    """Objects expected between two cameras: they left ``from_`` and will appear next at ``to``.

    number: expected number. low, high: ends of an interval of 80 %.
    """

    from_: str
    to: str
    number: float
    low: int
    high: int


class Between(Struct, frozen=True):
    """How many objects are expected between cameras at ``t``.

    They have left a camera, will appear again within an hour, and have not yet.

    since: objects that left earlier do not count.
    number: expected number. low, high: ends of an interval of 80 %.
    pairs: by pair of cameras, those with most objects first.
    """

    t: float
    since: float
    number: Annotated[float, metric("between_cameras", "Objects expected between cameras")]
    low: int
    high: int
    pairs: list[BetweenPair] = []


class DaemonStatus(Status, frozen=True):
    """State of the daemon, as published on ``status/daemon``.

    site, epoch, version: site of the daemon, and the version of the topology that it published
        last; 0 if there is none.
    rejects, reject_samples: rejected input by reason.
    dropped: publications dropped for lack of room, by camera.
    catching_up: None if the learner is up to date.
    between: objects between cameras, of at most a hundred pairs unless all are asked for; None
        without matches, and while nothing has been learned.
    warnings: what somebody should look at, though it works: a sentence each.
    """

    site: str = ""
    epoch: str = ""
    version: Annotated[int, metric("topology_version", "Newest version of the topology")] = 0
    events: EventCounts = EventCounts()
    rejects: Annotated[dict[str, int], metric("rejected_total", "Inputs that were rejected")] = {}
    reject_samples: dict[str, list[str]] = {}
    dropped: dict[str, int] = {}
    learner: LearnerCounts = LearnerCounts()
    catching_up: CatchingUp | None = None
    predictions: Annotated[int, metric("predictions_total", "Predictions published")] = 0
    matches_skipped: Annotated[
        int, metric("matches_skipped_total", "Entries without a match for lack of time")
    ] = 0
    questions_refused: int = 0
    score: SelfScore | None = None
    alarms: list[Alarm] = []
    between: Between | None = None
    names: NamesStatus = NamesStatus()
    journal: JournalStatus = JournalStatus()
    cameras: dict[str, CameraFigures] = {}
    warnings: list[str] = []
