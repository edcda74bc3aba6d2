"""Settings of a grabber (the ``[vision]`` table of the configuration), with their units."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0)]


class VisionSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of one grabber (the ``[vision]`` table of the configuration)."""

    analysed_fps: Positive = 7.0
    """Frames per second to analyse, as near as the source's rate allows; the rest is only grabbed.
    """
    working_width: Annotated[int, Meta(ge=1)] = 320
    """Wider frames are scaled down to this width (pixels) before analysis."""
    bootstrap_seconds: float = 3.0
    """The first background is the median of the frames of this period."""
    background_seconds: Positive = 20.0
    """Time constant with which the background follows changes of the settled scene."""
    confirm_seconds: float = 0.5
    """Minimum time something must be tracked, and move, before it counts as an object."""
    patience_seconds: Positive = 1.5
    """Time an object may be out of sight before its track ends."""
    stitch_seconds: float = 10.0
    """Time within which a track that broke in mid-view may be found and continue its passage."""
    tracks_max: Annotated[int, Meta(ge=1)] = 200
    """Maximum number of tracks at a time; further objects are not tracked."""
    open_timeout_seconds: Positive = 5.0
    """Timeout for opening a stream."""
    read_timeout_seconds: Positive = 3.0
    """Time without a frame after which a stream is reopened."""
    backoff_min_seconds: Positive = 0.5
    """Delay before a lost stream is reopened for the first time; it doubles with each attempt."""
    backoff_max_seconds: Positive = 15.0
    """Maximum delay before a lost stream is reopened."""
