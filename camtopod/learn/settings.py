"""Every limit and every constant of the learner that somebody may want to set, with its unit."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct


class Settings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the learner (the ``[learn]`` table of the configuration)."""

    lateness_seconds: Annotated[float, Meta(ge=0)] = 5.0
    """How much out of order events may come; later ones are counted, not learned."""
    ahead_seconds_max: Annotated[float, Meta(ge=0)] = 60.0
    """A single camera whose clock is up to this much ahead makes nobody else late; one as much
    behind is waited for.
    """
    version_seconds: Annotated[float, Meta(gt=0)] = 60.0
    """Event time between two looks at whether a new version is due."""
    refit_share: Annotated[float, Meta(ge=0)] = 0.2
    """A version is due when the events since the last are this share of the window ..."""
    refit_hours: Annotated[float, Meta(ge=0)] = 1.0
    """... or when there are any and this much event time has passed."""
    window_hours: Annotated[float, Meta(gt=0)] = 336.0
    """Forgetting: events older than this are not learned from; on a busy site the number of events
    forgets sooner.
    """
    window_events: Annotated[int, Meta(ge=1)] = 60_000
    """Of all events the newest so many are learned from, be they of a day, ..."""
    window_camera_events: Annotated[int, Meta(ge=0)] = 2_000
    """... or so many for each camera, if that is more, ..."""
    window_events_max: Annotated[int, Meta(ge=1)] = 20_000_000
    """... but never more than this."""
    transit_max_seconds: Annotated[float, Meta(gt=0)] = 180.0
    """The longest transit time looked for, but for long ways that nearly all take as long
    (`long_ways`).
    """
    overlap_max_seconds: Annotated[float, Meta(ge=0)] = 120.0
    """How long before it leaves one view an object may be seen to appear in an overlapping one."""
    overlap_tolerance_seconds: Annotated[float, Meta(ge=0)] = 0.45
    """T of the thesis's overlap test (table 4.4)."""
    candidates_max: Annotated[int, Meta(ge=1)] = 8_000_000
    """At most this many (departure, arrival) candidates are weighed in one fit; beyond, only likely
    ones are.
    """
    publish_q_max: Annotated[float, Meta(ge=0, le=1)] = 0.01
    """A link is published when its false discovery rate is at most this ..."""
    publish_probability_min: Annotated[float, Meta(ge=0, le=1)] = 0.03
    """... and at least this share of those leaving takes it."""
    missed_share_max: Annotated[float, Meta(ge=0, lt=1)] = 0.25
    """A link is an effect of missed passages when a camera missing at most this share of them could
    explain it.
    """
    correct_clocks: bool = False
    """Transit times are stated in right time instead of by the cameras' own clocks; offsets are
    published anyway.
    """
    cameras_max: Annotated[int, Meta(ge=1)] = 10_000
    """Events of further cameras are refused."""
