"""Every limit and every constant of the grabber that somebody may want to set, with its unit."""

from __future__ import annotations

from msgspec import Struct


class VisionSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of one grabber (the ``[vision]`` table of the configuration).

    Lengths called ``_heights`` are in multiples of the height of the person in question, so one value serves
    cameras of any size and distance.
    """

    analysed_fps: float = 7.0
    """Frames per second that are looked at; the rest are only grabbed."""
    working_width: int = 320
    """Frames wider than this are scaled down to it before anything else, pixels."""
    open_timeout_seconds: float = 5.0
    """How long opening a stream may take."""
    read_timeout_seconds: float = 3.0
    """How long a stream may be silent before it is opened anew."""
    backoff_min_seconds: float = 0.5
    """First wait before a lost stream is opened anew; doubles up to the largest."""
    backoff_max_seconds: float = 15.0
    """Largest wait before a lost stream is opened anew."""
