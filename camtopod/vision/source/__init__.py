"""Video sources: a file, a stream or a device -> frames with capture times.

`source_url` tells the kind of a source and encodes its password; `capture` wraps OpenCV. On top of
it `recorded` reads a file and `live` a stream or device, which reconnects; `frame_times` estimates
capture times from presentation stamps. `ffmpeg_log` finds out why a stream cannot be opened,
`makers` where a camera's stream may be; `probe` describes a source for people, with a picture, and
`remarks` what could be better about it.
"""

from camtopod.vision.source.capture import State as State
from camtopod.vision.source.ffmpeg_log import FfmpegLog as FfmpegLog, captured_log as captured_log
from camtopod.vision.source.live import LiveSource as LiveSource
from camtopod.vision.source.makers import streams_by_maker as streams_by_maker
from camtopod.vision.source.probe import (
    PROBE_SECONDS_MAX as PROBE_SECONDS_MAX,
    SETTLE_SECONDS_MAX as SETTLE_SECONDS_MAX,
    Probe as Probe,
    ProbeRequest as ProbeRequest,
    decoders as decoders,
)
from camtopod.vision.source.recorded import RecordedSource as RecordedSource
from camtopod.vision.source.source_url import (
    RETRY_SEPARATOR as RETRY_SEPARATOR,
    device_number as device_number,
    file_path as file_path,
    kind_of as kind_of,
    percent_encoded as percent_encoded,
)
