"""Video sources: a file, a stream or a device -> frames with capture times.

`source_url` tells the kind of a source and encodes its password; `capture` wraps OpenCV. On top of
it `recorded` reads a file and `live` a stream or device, which reconnects; `frame_times` estimates
capture times from presentation stamps. `ffmpeg_log` finds out why a stream cannot be opened,
`makers` where a camera's stream may be, `substreams` where a
smaller one is; `probe` describes a source for people, with a picture from `settled_picture`;
`errors` has the exceptions.
"""

from __future__ import annotations

from camtopod.vision.source.ffmpeg_log import FfmpegLog, captured_log
from camtopod.vision.source.live import LiveSource
from camtopod.vision.source.makers import streams_by_maker
from camtopod.vision.source.probe import PROBE_SECONDS, Probe, ProbeRequest, decoders
from camtopod.vision.source.recorded import RecordedSource
from camtopod.vision.source.settled_picture import SETTLE_SECONDS_MAX
from camtopod.vision.source.source_url import RETRY_SEPARATOR, kind_of, percent_encoded
from camtopod.vision.source.substreams import ENOUGH_FPS, ENOUGH_HEIGHT, smaller_stream

__all__ = [
    "ENOUGH_FPS",
    "ENOUGH_HEIGHT",
    "PROBE_SECONDS",
    "RETRY_SEPARATOR",
    "SETTLE_SECONDS_MAX",
    "FfmpegLog",
    "LiveSource",
    "Probe",
    "ProbeRequest",
    "RecordedSource",
    "captured_log",
    "decoders",
    "kind_of",
    "percent_encoded",
    "smaller_stream",
    "streams_by_maker",
]
