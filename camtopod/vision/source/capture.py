"""Frames with capture times from a file, an RTSP stream or a device, through OpenCV.

Properties of OpenCV's FFmpeg backend that this code respects:

- The backend must be named, or the timeouts are ignored.
- With more than one decoder thread, stale frames are returned as good ones after a stall.
- A capture that returned False once spins and never recovers.
- Releasing a capture from another thread while it reads crashes.
- Without ``rtsp_transport;tcp`` it switches to UDP.
- To reduce the frame rate, skip `retrieve`, never `grab`, or the stream falls behind.
- The luma plane must be requested before the first `retrieve`, which fixes the conversion.
- `retrieve` calls a frame good that FFmpeg could not convert, and returns an older one, or none.
- Luma of BT.709 is not copied: it is converted to that of BT.601, by way of colours, in three times
  the time that the colours alone take.
"""

from __future__ import annotations

import math
import os
import re
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from camtopod.vision.detect import Luma, shrunk
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.ffmpeg_log import NO_LOG, FfmpegLog, environment
from camtopod.vision.source.source_url import (
    device_number,
    file_path,
    is_path,
    kind_of,
    percent_encoded,
)

STREAM_OPTIONS = "rtsp_transport;tcp|allowed_media_types;video"
"""FFmpeg options of streams."""
SDP_OPTIONS = "protocol_whitelist;file,udp,rtp|allowed_media_types;video"
"""FFmpeg options of streams that a file describes."""
QUICK_OPTIONS = "|probesize;32768|analyzeduration;300000"
"""More of them at first: the small probe gives the first frame after 0.6 s instead of 1.9 s."""
JPEG_OPTIONS = "|input_format;mjpeg"
"""More of them for JPEG pictures that are found by their own markers, whatever is between them.

FFmpeg's reader of parts wants them to say ``Content-Type: image/jpeg`` exactly.
"""
OPTIONS_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
"""Environment variable from which OpenCV reads FFmpeg options; a user's value replaces ours."""
_DEVICES_OPTION = "hw_decoders_any"
"""FFmpeg option that names kinds of hardware decoders; OpenCV ignores it unless asked for them."""
_DECODER_OPTION = "video_codec"
"""FFmpeg option that names a decoder."""
LUMA_FORMATS = frozenset({"I420", "YV12", "Y42B", "444P", "NV12", "NV21", "Y800"})
"""FFmpeg's names of pixel formats that begin with a plane of 8-bit luma."""
_BT_709 = re.compile("1...(?P<full_range>.)10000....000.....00000001")
"""Bits by which headers of H.264 and H.265 say that the luma is that of BT.709.

A description of the signal: kind, range, colours: primaries, transfer, matrix.
"""
PATIENT_OPTIONS = "probesize;1000000000|analyzeduration;1000000000"
"""FFmpeg options of a file whose frames have no known size: its video begins late."""
CALL_SECONDS_MAX = 4.0
"""Timeout for opening a stream, and for waiting for a frame of it."""
PATIENCE = 5.0
"""Factor of it for a stream that gives nothing within it.

Its keyframes, frames or segments may be farther apart.
"""
THOROUGH_OPTIONS = f"|probesize;100000000|analyzeduration;{1e6 * CALL_SECONDS_MAX * PATIENCE:.0f}"
"""FFmpeg options, instead of the quick ones, for a stream that needs patience."""
IMAGE_WIDTH_MAX = 1920
"""Largest width (pixels) of an image in colour, which a detector examines."""
_VIDEO_RANGE = (16 + np.arange(256) * 219 / 255).round().astype(np.uint8)
"""Luma as video has it, 16 to 235, by the grey level of the image in colour."""
FAULTS_FRAMES = 100.0
"""Number of frames over which the share of those with a fault is counted, about."""
FAULTS_SHARE_MAX = 0.03
"""Share of frames with a fault above which packets are lost again and again."""
_CODECS = {
    "avc1": "H.264",
    "h264": "H.264",
    "hev1": "H.265",
    "hevc": "H.265",
    "hvc1": "H.265",
    "mjpg": "MJPEG",
    "mpg2": "MPEG-2",
    "fmp4": "MPEG-4",
    "mp4v": "MPEG-4",
    "vp09": "VP9",
    "av01": "AV1",
}
"""Name of a codec by its four-character code."""
DURATION_MAX = 1e9
"""Longest duration that is believed, seconds; what is longer is a date, or was never set."""
HEARTBEAT_SECONDS = 0.5
"""Longest time until a source yields while it waits, and shortest until it connects again."""


State = Literal["connecting", "running", "stalled", "ended"]
"""``connecting``: no frame has arrived yet; ``stalled``: frames arrived before, reconnecting."""


class Frame(NamedTuple):
    """A frame to analyse: capture time (seconds) and luma (H, W) at working size."""

    t: float
    luma: Luma
    image: Luma | None = None
    """The same in colour and at full size (H, W, 3), if it was asked for."""
    shift: float = 0.0
    """By how many seconds the wall clock has been set since ``t`` began to count."""


class Source:
    """State and counters of a source, whatever its kind."""

    state: State = "connecting"
    reason: str
    """Readable reason why the state is not ``running``; "" if it is. Contains no password."""
    is_lost = False
    """True if there are no frames, for a reason that more patience does not help against."""
    frames_grabbed = frames_dropped = connections = failures = untrusted_stamps = 0
    """Counters: frames, those that were not decoded or analysed, and so on."""


class Capture:
    """An open OpenCV capture. For a single thread; a stream is unusable after a failed `grab`."""

    def __init__(
        self,
        source: str,
        settings: VisionSettings,
        colour: bool = False,
        ffmpeg_log: FfmpegLog = NO_LOG,
        patient: bool = False,
        bare_jpeg: bool = False,
    ) -> None:
        """Open ``source``; `is_open` tells if that worked. Blocks for at most the timeout.

        colour: frames have an image in colour. The luma then differs from that of the video by its
            rounding.
        ffmpeg_log: tells which frames are damaged or none; without it all are believed.
        patient: a stream needs patience (`call_seconds_max`).
        bare_jpeg: a stream is JPEG pictures, to be found without what its parts say of them.
        """
        cv2.utils.logging.setLogLevel(0)  # its messages contain URLs with passwords
        # Images are so small that waking more threads costs more than it gains.
        cv2.setNumThreads(1)

        # Open with timeouts (streams) and one decoder thread.
        kind = kind_of(source)
        options = SDP_OPTIONS if is_path(source) else STREAM_OPTIONS
        options += THOROUGH_OPTIONS if patient and not bare_jpeg else QUICK_OPTIONS
        options += JPEG_OPTIONS if bare_jpeg else ""
        options = os.environ.get(OPTIONS_VARIABLE, options if kind == "stream" else "")
        self._capture = _opened(source, patient, options)
        if kind == "file" and self.is_open and self.size == (0, 0):
            options = options or PATIENT_OPTIONS
            self._capture = _opened(source, patient, options)

        # Request the luma plane if the pixel format has one that is copied as it is.
        self._width_max = settings.working_width
        self._image: Luma | None = None
        """Buffer of the latest frame; allocating a new one costs more than filling it."""
        has_luma = (
            kind != "device"
            and not any(option in options for option in (_DEVICES_OPTION, _DECODER_OPTION))
            and _four_characters(self._capture, cv2.CAP_PROP_CODEC_PIXEL_FORMAT) in LUMA_FORMATS
        )
        self._colour = colour
        has_header = has_luma and self.codec in ("H.264", "H.265")
        bt_709 = _BT_709.search(_header_bits(self._capture)) if has_header else None
        is_plane = has_luma and not colour and bt_709 is None
        if is_plane:
            self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        is_full_range = bt_709 is not None and bt_709["full_range"] == "1"
        self._is_stretched = has_luma and not is_plane and not is_full_range
        """True if frames have a larger range of grey levels than the video's luma."""

        # Begin without faults.
        self._ffmpeg_log = ffmpeg_log
        self._ffmpeg_log.newest_fault()  # forgets those of opening, which looks far ahead
        self.fault = ""
        """Why the latest frame that could not be decoded was none; "" if that is not known."""
        self._has_fault = False
        """True if the grabbed frame is damaged, or FFmpeg has told of damage since the last one."""
        self._fault_share = 0.0
        """Share of such frames among the latest."""
        self._is_joined = kind != "stream"
        """True from the first frame on; a stream begins with messages about earlier pictures."""

    @property
    def is_open(self) -> bool:
        """True if opening worked (it stays so when the source dies)."""
        return bool(self._capture.isOpened())

    @property
    def fps(self) -> float:
        """Frame rate that the source declares; 0.0 if unknown."""
        return max(0.0, float(self._capture.get(cv2.CAP_PROP_FPS)))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the source's images, pixels."""
        return (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )

    @property
    def codec(self) -> str:
        """Name of the codec."""
        code = _four_characters(self._capture, cv2.CAP_PROP_FOURCC).strip("\0 ")
        return _CODECS.get(code.lower(), code or "unknown codec")

    @property
    def is_jpeg(self) -> bool:
        """True if each picture is coded by itself, as JPEG."""
        return self.codec == _CODECS["mjpg"]

    @property
    def seconds(self) -> float:
        """Duration that a file or recording declares; 0.0 if unknown.

        Matroska files count it from the stamp 0 on: ask while the first frame is grabbed.
        """
        if not self.fps:
            return 0.0
        stamp = self._capture.get(cv2.CAP_PROP_PTS) / self.fps
        first_stamp = stamp - self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
        seconds = float(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)) / self.fps
        seconds -= first_stamp if 0.0 < first_stamp < seconds else 0.0
        return seconds if 0.0 <= seconds < DURATION_MAX else 0.0

    def grab(self) -> float | None:
        """Take the next frame without converting it; None if there is none.

        Then a stream has died; a file has ended, or has a part that cannot be read. Returns the
        frame's presentation time in seconds, 0.0 if unknown.
        """
        good = self._capture.grab()
        fault = self._ffmpeg_log.newest_fault()
        self.fault = fault or self.fault
        self._has_fault = self._is_joined and bool(fault)
        if not good:
            return None
        self._is_joined = True
        self._fault_share += (self._has_fault - self._fault_share) / FAULTS_FRAMES
        return float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0

    @property
    def is_often_damaged(self) -> bool:
        """True if frames are damaged again and again, as when packets are lost."""
        return self._fault_share > FAULTS_SHARE_MAX

    def retrieve(self) -> Luma | None:
        """Return the grabbed frame's luma (H, W) at working size.

        None if it is damaged, or could not be decoded or converted; `fault` has the reason. Frames
        that follow from a damaged one are good enough: most of their pixels are right, and it may
        be long until the next keyframe.
        """
        if self._has_fault:
            return None
        good, image = self._capture.retrieve(self._image)
        fault = self._ffmpeg_log.newest_fault()
        if fault or not good:
            self.fault = fault or self.fault
            return None
        self._image = image
        luma = shrunk(_grey(image), self._width_max)
        return cv2.LUT(luma, _VIDEO_RANGE) if self._is_stretched else luma

    def frame(self) -> Frame | None:
        """Return the grabbed frame with time 0.0, in colour as well if that was asked for.

        None if it cannot be decoded.
        """
        luma = self.retrieve()
        if luma is None:
            return None
        return Frame(0.0, luma, self.image() if self._colour else None)

    def image(self, width_max: int = IMAGE_WIDTH_MAX) -> Luma:
        """Return a copy of the frame retrieved last, at most ``width_max`` pixels wide.

        It has colours, (H, W, 3), if they were asked for.
        """
        assert self._image is not None, "retrieve first"
        return narrowed(self._image, width_max)

    def release(self) -> None:
        """Close the capture. Call it from the thread that reads."""
        self._capture.release()


class FrameSelector:
    """Chooses the frames to analyse, by time stamps, for a rate as near to ``fps`` as possible."""

    def __init__(self, fps: float) -> None:
        self._interval = 1.0 / fps
        self._last_stamp = math.inf
        self._last_taken = math.inf

    def wants(self, stamp: float) -> bool:
        """Return True if the frame with this stamp (seconds) is to be analysed.

        Must be called for every frame.
        """
        # Due: nearer to the wanted time than the next frame would be, or the stamps went back.
        step = max(0.0, stamp - self._last_stamp)
        due = not 0.0 <= stamp - self._last_taken < self._interval - step / 2
        self._last_stamp = stamp
        if due:
            self._last_taken = stamp
        return due


def call_seconds_max(patient: bool) -> float:
    """Return the timeout for opening a stream, and for waiting for a frame of it, seconds."""
    return CALL_SECONDS_MAX * (PATIENCE if patient else 1)


def _opened(source: str, patient: bool, options: str) -> cv2.VideoCapture:
    """Open a device, a stream with its timeouts, or a file, with FFmpeg's ``options``."""
    number = device_number(source)
    if number is not None:
        return cv2.VideoCapture(number)
    parameters = [cv2.CAP_PROP_N_THREADS, 1]
    is_stream = kind_of(source) == "stream"
    path = f"file:{file_path(source)}"  # a colon in a path ends no protocol
    source = path if is_path(source) else percent_encoded(source)
    if is_stream:
        milliseconds = round(1000 * call_seconds_max(patient))
        for timeout in (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, cv2.CAP_PROP_READ_TIMEOUT_MSEC):
            parameters += [timeout, milliseconds]
    if _DEVICES_OPTION in options:
        parameters += [cv2.CAP_PROP_HW_ACCELERATION, cv2.VIDEO_ACCELERATION_ANY]
    bytes_: Any = os.fsencode(source)  # need not be UTF-8: OpenCV crashes on such a string
    with environment(OPTIONS_VARIABLE, options):
        return cv2.VideoCapture(bytes_, cv2.CAP_FFMPEG, parameters)


def _four_characters(capture: cv2.VideoCapture, of: int) -> str:
    code = int(capture.get(of))
    return code.to_bytes(4, "little").decode("latin-1") if 0 <= code < 1 << 32 else ""


def _header_bits(capture: cv2.VideoCapture) -> str:
    """Return the bits of the headers that a source has outside of its frames; "" if none."""
    data: Luma | None = None
    _, data = capture.retrieve(data, int(capture.get(cv2.CAP_PROP_CODEC_EXTRADATA_INDEX)))
    header = b"" if data is None else data.tobytes().replace(b"\0\0\3", b"\0\0")
    return "".join(f"{byte:08b}" for byte in header)


def _grey(image: Luma) -> Luma:
    """Return the luma (H, W) of an image, which may have colours (H, W, 3) or have none."""
    if image.ndim == 2 or image.shape[2] == 1:
        return image.reshape(image.shape[:2])
    return np.asarray(cv2.cvtColor(image[:, :, :3], cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def narrowed(image: Luma, width_max: int) -> Luma:
    """Return a copy of an image (H, W, 3), at most ``width_max`` pixels wide."""
    height, width = image.shape[:2]
    if width <= width_max:
        return image.copy()
    size = (width_max, round(height * width_max / width))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
