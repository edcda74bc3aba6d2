"""Frames with capture times from a file, an RTSP stream or a device, through OpenCV.

Properties of OpenCV's FFmpeg backend that this code respects:

- The backend must be named, or the timeouts are ignored.
- With more than one decoder thread, stale frames are returned as good ones after a stall.
- A capture that returned False once spins and never recovers.
- Releasing a capture from another thread while it reads crashes.
- Without ``rtsp_transport;tcp`` it switches to UDP.
- To reduce the frame rate, skip `retrieve`, never `grab`, or the stream falls behind.
- The luma plane must be requested before the first `retrieve`, which fixes the conversion.
- `retrieve` calls a picture good that FFmpeg could not convert, and returns an older one, or none.
"""

from __future__ import annotations

import os
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from camtopod.vision.detect import Luma, shrunk
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source.ffmpeg_log import FfmpegLog, environment
from camtopod.vision.source.source_url import device_number, file_path, kind_of, percent_encoded

STREAM_OPTIONS = "rtsp_transport;tcp|allowed_media_types;video"
"""FFmpeg options of streams."""
QUICK_OPTIONS = "|probesize;32768|analyzeduration;300000"
"""More of them at first: the small probe gives the first frame after 0.6 s instead of 1.9 s."""
PATIENCE = (1.0, 4.0, 20.0)
"""Factors of `READ_SECONDS_MAX` for streams, in the order in which they are tried.

A stream that gives nothing within one may have keyframes, pictures or segments farther apart.
"""
OPTIONS_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
"""Environment variable from which OpenCV reads FFmpeg options; a user's value replaces ours."""
_DEVICES_OPTION = "hw_decoders_any"
"""FFmpeg option that names kinds of hardware decoders; OpenCV ignores it unless asked for them."""
_DECODER_OPTION = "video_codec"
"""FFmpeg option that names a decoder."""
LUMA_FORMATS = frozenset({"I420", "YV12", "Y42B", "444P", "NV12", "NV21", "Y800"})
"""FFmpeg's names of pixel formats that begin with a plane of 8-bit luma."""
PATIENT_OPTIONS = "probesize;1000000000|analyzeduration;1000000000"
"""FFmpeg options of a file whose pictures have no known size: its video begins late."""
OPEN_SECONDS_MAX = 5.0
"""Timeout for opening a stream; with patience it is longer by as much as that for reading."""
READ_SECONDS_MAX = 3.0
"""Time without a frame after which a stream is reopened."""
IMAGE_WIDTH_MAX = 1920
"""Largest width (pixels) of an image in colour, which a detector examines."""
_VIDEO_RANGE = (16 + np.arange(256) * 219 / 255).round().astype(np.uint8)
"""Luma as video has it, 16 to 235, by the grey level of the image in colour."""
DAMAGED_PICTURES_MAX = 250
"""Pictures after a fault that are damaged if none is coded by itself, which is seldom so late."""
REORDERED_PICTURES = 3
"""Pictures by which a picture may come later than the message about it, as B pictures do."""
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
HEARTBEAT_SECONDS = 0.5
"""Longest time until a source yields while it waits."""
_STEP_RATE = 0.1
"""Weight of the newest interval in the running mean of frame intervals."""


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
    grabbed = 0
    dropped = 0
    connections = 0
    failures = 0
    untrusted_stamps = 0


class Capture:
    """An open OpenCV capture. For a single thread; a stream is unusable after a failed `grab`."""

    def __init__(
        self,
        source: str,
        settings: VisionSettings,
        colour: bool = False,
        ffmpeg_log: FfmpegLog | None = None,
        patience: float = PATIENCE[0],
    ) -> None:
        """Open ``source``; `is_open` tells if that worked. Blocks for at most the open timeout.

        colour: convert frames to colour, as `image` requires. The luma then differs from that of
            the video by its rounding.
        ffmpeg_log: tells which pictures are damaged or none; without it all are believed.
        patience: factor of the timeout for reading a stream (`timeouts`).
        """
        cv2.utils.logging.setLogLevel(0)  # its messages contain URLs with passwords
        # Images are so small that waking more threads costs more than it gains.
        cv2.setNumThreads(1)

        # Open with timeouts (streams) and one decoder thread.
        kind = kind_of(source)
        seconds = timeouts(patience) if kind == "stream" else None
        options = os.environ.get(OPTIONS_VARIABLE, _stream_options(patience) if seconds else "")
        number = device_number(source)
        if number is not None:
            self._capture = cv2.VideoCapture(number)
        else:
            self._capture = _opened(source, seconds, options)
            if kind == "file" and self.is_open and self.size == (0, 0):
                options = options or PATIENT_OPTIONS
                self._capture = _opened(source, None, options)
        self._ffmpeg_log = ffmpeg_log or FfmpegLog()
        self._ffmpeg_log.newest_fault()  # forgets those of opening, which looks far ahead
        self.fault = ""
        """Why the latest picture that could not be decoded was none; "" if that is not known."""
        self._damaged = 0
        """Number of pictures that are taken for damaged unless one comes coded by itself."""
        self._is_joined = kind != "stream"
        """True from the first picture on; a stream begins with messages about what came before."""

        # Request the luma plane if the pixel format has one.
        self._width_max = settings.working_width
        self._image: Luma | None = None
        """Buffer of the latest frame; allocating a new one costs more than filling it."""
        pixels = ""
        if kind != "device" and _DEVICES_OPTION not in options and _DECODER_OPTION not in options:
            pixels = _four_characters(self._capture, cv2.CAP_PROP_CODEC_PIXEL_FORMAT)
        if pixels in LUMA_FORMATS and not colour:
            self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        self._from_colour = pixels in LUMA_FORMATS and colour
        self._colour = colour

    @property
    def is_open(self) -> bool:
        """True if opening worked (it stays so when the source dies)."""
        return bool(self._capture.isOpened())

    @property
    def fps(self) -> float:
        """Frame rate that the source declares; 0.0 if unknown."""
        fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        return fps if 0.0 < fps < 1000.0 else 0.0

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the source's images, pixels."""
        get = self._capture.get
        return int(get(cv2.CAP_PROP_FRAME_WIDTH)), int(get(cv2.CAP_PROP_FRAME_HEIGHT))

    @property
    def codec(self) -> str:
        """Name of the codec."""
        code = _four_characters(self._capture, cv2.CAP_PROP_FOURCC).strip("\0 ")
        return _CODECS.get(code.lower(), code or "unknown codec")

    @property
    def pictures(self) -> int:
        """Number of pictures that a file declares; 0 if unknown."""
        return max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))

    @property
    def seconds(self) -> float:
        """Duration that a file declares; 0.0 if unknown."""
        fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        return self.pictures / fps if fps > 0.0 else 0.0

    def grab(self) -> float | None:
        """Take the next frame without converting it; None if there is none.

        Then a stream has died; a file has ended, or has a part that cannot be read. Returns the
        frame's presentation time in seconds, 0.0 if unknown.
        """
        good = self._capture.grab()
        if fault := self._ffmpeg_log.newest_fault():
            self.fault = fault
            if self._is_joined:
                self._damaged = DAMAGED_PICTURES_MAX
        if not good:
            return None
        self._is_joined = True
        if self._damaged:
            self._damaged -= 1
            late = DAMAGED_PICTURES_MAX - self._damaged > REORDERED_PICTURES
            if late and self._capture.get(cv2.CAP_PROP_FRAME_TYPE) == ord("I"):
                self._damaged = 0
        return float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0

    def retrieve(self) -> Luma | None:
        """Return the grabbed frame's luma (H, W) at working size.

        None if it is no picture: damaged, or it could not be decoded or converted; `fault` has the
        reason.
        """
        if self._damaged:
            return None
        good, image = self._capture.retrieve(self._image)
        fault = self._ffmpeg_log.newest_fault()
        if fault or not good:
            unknown = "the size of its pictures is unknown" if self.size == (0, 0) else ""
            self.fault = fault or unknown or self.fault
            return None
        self._image = image
        luma = shrunk(grey(self._image), self._width_max)
        if self._from_colour:
            luma = cv2.LUT(luma, _VIDEO_RANGE)
        return luma

    def frame(self) -> Frame | None:
        """Return the grabbed frame with time 0.0, in colour as well if that was asked for.

        None if it cannot be decoded.
        """
        luma = self.retrieve()
        if luma is None:
            return None
        return Frame(0.0, luma, self.image(IMAGE_WIDTH_MAX) if self._colour else None)

    @property
    def has_image(self) -> bool:
        """True if a frame has been retrieved."""
        return self._image is not None

    def image(self, width_max: int) -> Luma:
        """Return a copy of the latest retrieved frame, at most ``width_max`` pixels wide.

        It has colours, (H, W, 3), if they were asked for.
        """
        assert self._image is not None, "retrieve first"
        height, width = self._image.shape[:2]
        if width <= width_max:
            return self._image.copy()
        size = (width_max, round(height * width_max / width))
        return cv2.resize(self._image, size, interpolation=cv2.INTER_AREA)

    def release(self) -> None:
        """Close the capture. Call it from the thread that reads."""
        self._capture.release()


class FrameSelector:
    """Chooses the frames to analyse, by time stamps, for a rate as near to ``fps`` as possible."""

    def __init__(self, fps: float) -> None:
        self._interval = 1.0 / fps
        self._step = 0.0
        self._last_stamp: float | None = None
        self._last_taken: float | None = None

    def wants(self, stamp: float) -> bool:
        """Return True if the frame with this stamp (seconds) is to be analysed.

        Must be called for every frame.
        """
        # Running mean of the source's frame interval.
        if self._last_stamp is not None and stamp > self._last_stamp:
            step = min(stamp - self._last_stamp, 1.0)
            self._step += (step - self._step) * (_STEP_RATE if self._step else 1.0)
        self._last_stamp = stamp

        # Due: nearer to the wanted time than the next frame would be, or the stamps went back.
        due = (
            self._last_taken is None
            or not 0.0 <= stamp - self._last_taken < self._interval - self._step / 2
        )
        if due:
            self._last_taken = stamp
        return due


def timeouts(patience: float) -> tuple[float, float]:
    """Return the timeouts for opening and reading a stream, seconds."""
    read = patience * READ_SECONDS_MAX
    return OPEN_SECONDS_MAX + read - READ_SECONDS_MAX, read


def _stream_options(patience: float) -> str:
    """Return FFmpeg's options for a stream."""
    if patience == PATIENCE[0]:
        return STREAM_OPTIONS + QUICK_OPTIONS
    microseconds = round(1e6 * timeouts(patience)[1])
    return f"{STREAM_OPTIONS}|probesize;100000000|analyzeduration;{microseconds}"


def _opened(source: str, seconds: tuple[float, float] | None, options: str) -> cv2.VideoCapture:
    """Open a stream with its timeouts, or a file, with FFmpeg's ``options``."""
    parameters = [cv2.CAP_PROP_N_THREADS, 1]
    if seconds is not None:
        source = percent_encoded(source)
        parameters += [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(1000 * seconds[0])]
        parameters += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(1000 * seconds[1])]
    else:
        source = f"file:{file_path(source)}"  # what is before a colon is no protocol
    if _DEVICES_OPTION in options:
        parameters += [cv2.CAP_PROP_HW_ACCELERATION, cv2.VIDEO_ACCELERATION_ANY]
    bytes_: Any = os.fsencode(source)  # need not be UTF-8: OpenCV crashes on such a string
    with environment(OPTIONS_VARIABLE, options):
        return cv2.VideoCapture(bytes_, cv2.CAP_FFMPEG, parameters)


def _four_characters(capture: cv2.VideoCapture, of: int) -> str:
    code = int(capture.get(of))
    return code.to_bytes(4, "little").decode("latin-1") if 0 <= code < 1 << 32 else ""


def grey(image: Luma) -> Luma:
    """Return the luma (H, W) of an image, which may have colours (H, W, 3) or have none."""
    if image.ndim == 2:
        return image
    if image.shape[2] == 1:
        return image[:, :, 0]
    return np.asarray(cv2.cvtColor(image[:, :, :3], cv2.COLOR_BGR2GRAY), dtype=np.uint8)
