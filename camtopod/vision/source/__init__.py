"""Video sources: a file, a stream or a device -> frames with capture times.

`source_url` tells the kind of a source, encodes its password, and knows where streams may be;
`capture` wraps OpenCV. On top of it `recorded` reads a file and `live` a stream or device, which
reconnects; `file_times` and `frame_times` estimate capture times from presentation stamps.
`ffmpeg_log` and `refusal` find out why a stream cannot be opened, `remarks` what could be better
about a source; `probe` describes it for people, with a picture.
"""

from camtopod.vision.source.capture import HEARTBEAT_SECONDS as HEARTBEAT_SECONDS, State as State
from camtopod.vision.source.ffmpeg_log import (
    NO_LOG as NO_LOG,
    FfmpegLog as FfmpegLog,
    captured_log as captured_log,
)
from camtopod.vision.source.live import LiveSource as LiveSource
from camtopod.vision.source.probe import (
    PROBE_SECONDS_MAX as PROBE_SECONDS_MAX,
    SETTLE_SECONDS_MAX as SETTLE_SECONDS_MAX,
    Probe as Probe,
    ProbeRequest as ProbeRequest,
    decoders as decoders,
)
from camtopod.vision.source.recorded import (
    NO_OPTIONS as NO_OPTIONS,
    FileOptions as FileOptions,
    RecordedSource as RecordedSource,
)
from camtopod.vision.source.refusal import why_no_stream as why_no_stream
from camtopod.vision.source.source_url import (
    RETRY_SEPARATOR as RETRY_SEPARATOR,
    device_number as device_number,
    file_path as file_path,
    is_path as is_path,
    kind_of as kind_of,
    percent_encoded as percent_encoded,
    streams_by_maker as streams_by_maker,
)
