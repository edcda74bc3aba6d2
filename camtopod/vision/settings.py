"""Every limit and every constant of the grabber that somebody may want to set, with its unit."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0)]


class VisionSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of one grabber (the ``[vision]`` table of the configuration)."""

    analysed_fps: Positive = 7.0
    """Frames per second that are looked at (as near as the source's rate allows); the rest are only
    grabbed."""
    working_width: Annotated[int, Meta(ge=1)] = 320
    """Frames wider than this are scaled down to it before anything else, pixels."""
    bootstrap_seconds: float = 3.0
    """The first background is the median over this long."""
    background_seconds: Positive = 20.0
    """Time constant with which the background follows the settled scene."""
    confirm_seconds: float = 0.5
    """How long something must be followed, and move, before it is an object."""
    patience_seconds: Positive = 1.5
    """How long an object may be out of sight before its track has ended."""
    stitch_seconds: float = 10.0
    """How long after a track broke in mid-view it may be found again and stay one passage."""
    tracks_max: Annotated[int, Meta(ge=1)] = 200
    """At most this many objects at once; further ones are not followed."""
    open_timeout_seconds: Positive = 5.0
    """How long opening a stream may take."""
    read_timeout_seconds: Positive = 3.0
    """How long a stream may be silent before it is opened anew."""
    backoff_min_seconds: Positive = 0.5
    """First wait before a lost stream is opened anew; doubles up to the largest."""
    backoff_max_seconds: Positive = 15.0
    """Largest wait before a lost stream is opened anew."""
