"""Types of the records' fields: names, ranges of numbers, columns; and which field is a metric."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

NAME_PATTERN = r"^[A-Za-z0-9_.-]{1,64}\Z"
"""Regular expression of a name; ``\\Z`` refuses the newline that ``$`` would allow."""
RESERVED = ("daemon", ".", "..")
"""Names that no camera may have: ``status/daemon`` is the daemon's, and spools are named after
cameras."""
CAMERA_PATTERN = r"^(?!(daemon|\.|\.\.)\Z)[A-Za-z0-9_.-]{1,64}\Z"
"""Regular expression of a camera id: a name that is not reserved."""
ZONE_PATTERN = r"^[A-Za-z0-9_.-]{1,64}/[0-9]{1,9}\Z"
"""Regular expression of a zone id, CAMERA/NUMBER."""

# Ranges of numbers, checked on decoding. They are those of any possible site, not of a likely one.
Count = Annotated[int, Meta(ge=0, le=2**53)]
Number = Annotated[float, Meta(ge=0, le=1e15)]
"""Expected number, or a rate."""
Share = Annotated[float, Meta(ge=0, le=1.001)]
"""Share or probability; the upper end allows for rounding."""
Seconds = Annotated[float, Meta(ge=-1e11, le=1e11)]
"""Time since 1970, or a lag, which may be negative."""
Duration = Annotated[float, Meta(ge=0, le=1e11)]
"""Seconds, not negative."""
# Columns of numbers (`camtopod.columns`), in base64 where they are JSON.
Uint8s = Annotated[bytes, Meta(description="uint8, deflated by zlib")]
Int16s = Annotated[bytes, Meta(description="int16, little-endian, deflated by zlib")]
Int32s = Annotated[bytes, Meta(description="int32, little-endian, deflated by zlib")]
Float32s = Annotated[bytes, Meta(description="float32, little-endian, deflated by zlib")]
Float64s = Annotated[bytes, Meta(description="float64, little-endian, deflated by zlib")]
Covariance = Annotated[
    list[Annotated[list[Annotated[float, Meta(ge=-1, le=1)]], Meta(min_length=2, max_length=2)]],
    Meta(min_length=2, max_length=2),
]

SiteName = Annotated[str, Meta(pattern=NAME_PATTERN)]
CameraId = Annotated[str, Meta(pattern=CAMERA_PATTERN)]
ZoneId = Annotated[str, Meta(pattern=ZONE_PATTERN)]
Kind = Literal["entry", "exit"]
Relation = Literal["visible", "overlapped", "unseen"]
"""Relation of the zones of a link.

visible: two zones of one view, joined by its passages.
overlapped: zones of two views; most objects appear in the second before they leave the first.
unseen: zones of two views, joined by a path that no camera sees.
"""
PairRelation = Literal["overlapped", "unseen_path"]
"""Relation of two cameras: their views overlap, or a path that no camera sees joins them."""


def metric(name: str, meaning: str) -> Meta:
    """Make a field a metric of ``/metrics``: ``camtopod_`` and this name, and what it means."""
    return Meta(title=name, description=meaning)
