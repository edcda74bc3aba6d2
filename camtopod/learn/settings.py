"""Settings of the learner, with their units: the tables ``[learn]`` and ``[topology]`` of the
configuration.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from camtopod.records import CameraId

PAIRS_MAX = 100_000
"""Most pairs of a list: more than a user writes."""

Pairs = Annotated[
    tuple[tuple[CameraId, CameraId], ...],
    Meta(max_length=PAIRS_MAX, description='pairs of cameras, like [["lobby", "hall"]]'),
]
"""Pairs of cameras, the two of each in either order."""


class TopologySettings(Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of the site beforehand (the ``[topology]`` table of the configuration)."""

    neighbours: Pairs = ()
    """Pairs of cameras between which objects go without passing another camera, such as [["lobby",
    "hall"], ["hall", "stairs"]]. They need less evidence for a link, and predictions prefer them.
    """
    not_neighbours: Pairs = ()
    """Pairs of cameras between which nobody goes without passing another camera. They need more
    evidence; a link that is found nevertheless is marked as contradicted.
    """
    nobody_leaves: bool = False
    """Whether the site is closed: all objects appear again in some camera."""


class LearnSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The ``[learn]`` table of the configuration."""

    lateness_seconds: Annotated[float, Meta(ge=0)] = 5.0
    """Seconds of event time by which events may arrive out of order. Later events are learned at
    their time, too, but only count from the next version on.
    """
    ahead_seconds_max: Annotated[float, Meta(ge=0)] = 60.0
    """Largest clock offset that the learner makes up for, in seconds. A single camera whose clock
    is ahead by up to this much does not make other cameras' events late; the watermark waits for
    one that is behind by up to this much.
    """
    version_seconds: Annotated[float, Meta(ge=0.01)] = 60.0
    """Length of a tick in seconds of event time. After each tick with new events the learner checks
    whether a new version is due.
    """
    refit_share: Annotated[float, Meta(ge=0)] = 0.2
    """A new version is due when the events since the last one are this share of the window, and at
    least 10.
    """
    refit_hours: Annotated[float, Meta(ge=0)] = 1.0
    """A new version is due after this many hours of event time, if there are any new events."""
    window_hours: Annotated[float, Meta(gt=0)] = 336.0
    """Events older than this many hours are forgotten. On a busy site the limits on the number of
    events take effect sooner.
    """
    window_events: Annotated[int, Meta(ge=1)] = 60_000
    """Events that the window holds, over all cameras; the oldest are forgotten first."""
    window_camera_events: Annotated[int, Meta(ge=0)] = 2_000
    """The window holds this many events per camera if that is more than ``window_events``."""
    window_events_max: Annotated[int, Meta(ge=1)] = 20_000_000
    """Upper limit of the window in events, however many cameras there are."""
    overlap_tolerance_seconds: Annotated[float, Meta(ge=0)] = 0.45
    """Tolerance T of the thesis's overlap test (table 4.4), in seconds."""
    candidates_max: Annotated[int, Meta(ge=1)] = 8_000_000
    """Candidates (pairs of a departure and an arrival) up to which a fit considers all of them.
    Beyond that, only likely candidates are kept.
    """
    publish_q_max: Annotated[float, Meta(ge=0, le=1)] = 0.01
    """A link is published only if its false discovery rate is at most this."""
    publish_probability_min: Annotated[float, Meta(ge=0, le=1)] = 0.03
    """A link is published only if at least this share of the objects leaving its first zone takes
    it.
    """
    missed_share_max: Annotated[float, Meta(ge=0, lt=1)] = 0.25
    """A link is not published if a camera that misses at most this share of its passages could
    explain it.
    """
    correct_clocks: bool = False
    """Whether transit times are in corrected time instead of by the cameras' own clocks. Clock
    offsets are published in either case.
    """
    cameras_max: Annotated[int, Meta(ge=1)] = 10_000
    """Cameras that are learned from. Events of further cameras are refused, unless a camera that
    has been silent for an hour can give up its place.
    """


class Settings(LearnSettings, frozen=True, forbid_unknown_fields=True):
    """All settings of the learner: those of ``[learn]``, and what is known of the site.

    >>> known = TopologySettings(neighbours=(("lobby", "hall"),))
    >>> settings = Settings(topology=known)
    """

    topology: TopologySettings = TopologySettings()
