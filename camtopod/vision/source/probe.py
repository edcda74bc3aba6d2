"""Describe a source after reading it for some seconds, and explain its problems.

Runs as a process of its own,

    python -m camtopod.vision.source.probe

which reads a `ProbeRequest` from standard input and writes a `Probe` to standard output, both as
JSON.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import cv2
import msgspec
import numpy as np
from msgspec import Struct

from camtopod.vision.detect import Luma, shrunk
from camtopod.vision.detector.model import ModelReport, try_model
from camtopod.vision.settings import DetectorSettings, VisionSettings
from camtopod.vision.source.capture import PATIENCE, Capture, grey, timeouts
from camtopod.vision.source.ffmpeg_log import FfmpegLog, captured_log
from camtopod.vision.source.file_times import FPS_UNKNOWN
from camtopod.vision.source.frame_times import StampClock
from camtopod.vision.source.recorded import RecordedSource
from camtopod.vision.source.remarks import no_picture, remarks, unfit, why_not_opened, why_over
from camtopod.vision.source.source_url import kind_of

PROBE_SECONDS = 2.0
"""Time for which frames are counted, from the first one on."""
PROBE_LEVELS = 2
"""Number of degrees of patience with which a stream is opened."""
PROBE_SECONDS_MAX = PROBE_SECONDS + sum(
    seconds for patience in PATIENCE[:PROBE_LEVELS] for seconds in timeouts(patience)
)
"""Longest time of a probe without a picture."""
FILE_FRAMES = 50
"""Number of frames read of a file."""
PICTURE_WIDTH_MAX = 1280
"""Largest width (pixels) of the returned picture, which serves to draw zones on."""
SETTLE_SECONDS_MIN = 6.0
"""Least time of the pictures: slow people take some seconds to leave a place."""
SETTLE_SECONDS_MAX = 30.0
"""Time after which the best picture is taken, settled or not."""
SPACING_SECONDS = 0.5
"""Time between two pictures at first; it doubles each time that there are `PICTURES_MAX`."""
PICTURES_MAX = 16
"""Pictures that are kept, at most 2.8 MB each."""
MAJORITY = 0.6
"""Share of the pictures in which a settled pixel looks as in the median."""
LATEST_PICTURES = 3
"""Number of latest images; a pixel that differs from the median in all of them is not settled."""
SAME_GREY_LEVELS = 15
"""Largest difference of pixels that look the same, grey levels."""
UNSETTLED_SHARE_MAX = 0.002
"""Share of pixels that may be unsettled in a settled scene."""
_COMPARED_WIDTH = 320
"""Width (pixels) of the pictures that are compared."""
_ROWS = 64
"""Rows of which the median is taken at once, to save memory."""


class ProbeRequest(Struct):
    """What to probe: a source, with the grabber's settings."""

    source: str
    settings: VisionSettings
    picture: bool = False
    """Return a picture of the scene without people, too."""
    detector: DetectorSettings = DetectorSettings()
    """Run the detector once, too, if it has a model; a source need not be given then."""


class Probe(Struct):
    """Result of a probe."""

    problem: str = ""
    """Why the source cannot be used; "" if it can."""
    codec: str = ""
    width: int = 0
    height: int = 0
    fps: float = 0.0
    remarks: list[str] = []
    """What could be improved."""
    picture: bytes = b""
    """The scene without people as JPEG, as far as it has settled; empty unless requested."""
    detector: ModelReport = ModelReport()
    """The detector and its detections; empty if there is none."""

    @property
    def lines(self) -> list[str]:
        """The result for people, a line each.

        First ``H.264, 1920x1080, 25 frames a second``, say, or the problem; then the remarks.
        """
        rate = f"{self.fps:.3g} frames a second" if self.fps else "unknown frame rate"
        return [self.problem or f"{self.codec}, {self.width}x{self.height}, {rate}", *self.remarks]


class SettledPicture:
    """Picture of a scene without its people: the median of pictures over some seconds.

    A walking person covers a pixel in few of the pictures, so the median shows the background. The
    scene is settled if nearly every pixel looks the same in a clear majority of them. A person who
    stands still for the whole time is part of the scene.
    """

    def __init__(self) -> None:
        self._pictures: list[tuple[float, Luma]] = []
        """Times (seconds) and pictures."""
        self._spacing = SPACING_SECONDS
        self.settled = False
        """True if nearly every pixel looks the same in a majority of the pictures."""

    @property
    def seconds(self) -> float:
        """Time from the first to the last picture."""
        return self._pictures[-1][0] - self._pictures[0][0] if self._pictures else 0.0

    def wants(self, t: float) -> bool:
        """Return True if a picture taken at ``t`` (seconds) is needed."""
        return not self._pictures or t - self._pictures[-1][0] >= self._spacing

    def add(self, t: float, picture: Luma) -> None:
        """Add a picture taken at ``t`` (seconds); all are of one size."""
        # Make room: every second one, from now on at twice the spacing.
        if len(self._pictures) == PICTURES_MAX:
            self._pictures = self._pictures[::2]
            self._spacing *= 2
            if not self.wants(t):
                return

        self._pictures.append((t, picture))
        long_enough = self.seconds >= SETTLE_SECONDS_MIN
        self.settled = long_enough and self._unsettled_share() <= UNSETTLED_SHARE_MAX

    def _unsettled_share(self) -> float:
        """Return the share of pixels that differ from the median in too many pictures."""
        stack = np.stack([shrunk(grey(picture), _COMPARED_WIDTH) for _, picture in self._pictures])
        middle = _median(stack)
        same = np.stack([cv2.absdiff(one, middle) <= SAME_GREY_LEVELS for one in stack])
        minority = same.sum(axis=0) < MAJORITY * len(stack)
        lately = ~same[-LATEST_PICTURES:].any(axis=0)  # somebody has come or gone
        return float(np.mean(minority | lately))

    def picture(self) -> Luma | None:
        """Return the median of the pictures; None if there is none."""
        if not self._pictures:
            return None
        pictures = [picture for _, picture in self._pictures]
        result = pictures[0].copy()
        for top in range(0, len(result), _ROWS):
            rows = slice(top, top + _ROWS)
            result[rows] = _median(np.stack([picture[rows] for picture in pictures]))
        return result


def probe(request: ProbeRequest, ffmpeg_log: FfmpegLog) -> Probe:
    """Open the source, count its frames, and run the detector once.

    Takes at most `PROBE_SECONDS_MAX`, with a picture plus `SETTLE_SECONDS_MAX`. Never raises for a
    source that does not work.
    """
    source = request.source
    if kind_of(source) == "file":
        try:
            RecordedSource(source, request.settings, 0.0, False, ffmpeg_log=ffmpeg_log).close()
        except OSError as error:
            return Probe(error.strerror or str(error).removeprefix(f"{source}: "))

    for patience in PATIENCE[:PROBE_LEVELS]:
        seen, is_final = _seen(request, ffmpeg_log, patience)
        if is_final:
            break
    return seen


def _seen(request: ProbeRequest, ffmpeg_log: FfmpegLog, patience: float) -> tuple[Probe, bool]:
    """Return what a source is; False with it if more patience may show more."""
    source = request.source
    colour = request.picture or bool(request.detector.model)
    capture = Capture(source, request.settings, colour, ffmpeg_log, patience)
    try:
        if not capture.is_open:
            why = why_not_opened(source, ffmpeg_log)
            return Probe(f"cannot be opened{why and ': '}{why}"), True
        if kind_of(source) == "stream" and (why := unfit(source, capture)):
            return Probe(why), True
        settled = SettledPicture() if request.picture else None
        seen = _watched(capture, source, settled)
        if request.detector.model and not seen.problem:
            seen.detector = try_model(request.detector, capture.image(capture.size[0]))
        if settled is not None and (picture := settled.picture()) is not None:
            seen.picture = cv2.imencode(".jpg", picture)[1].tobytes()
            if not settled.settled:
                seen.remarks.append(
                    f"the scene has not settled within {settled.seconds:.0f} s, so its picture may "
                    "show people: take it again with `camtopod check --probe --pictures DIR`"
                )
        return seen, capture.has_image or kind_of(source) != "stream"
    finally:
        capture.release()


def _watched(capture: Capture, source: str, settled: SettledPicture | None) -> Probe:
    """Read frames for a while and return what they are; give ``settled`` those that it wants."""
    live = kind_of(source) != "file"
    frames: list[tuple[float, float]] = []
    """Stamp and arrival of each, seconds."""
    clock = StampClock()
    contrast = 0.0
    t = 0.0
    ended = 0.0
    while True:
        counted = t >= PROBE_SECONDS if live else len(frames) >= FILE_FRAMES
        if counted and (settled is None or settled.settled or t >= SETTLE_SECONDS_MAX):
            break

        # Grab a frame. Its time counts from the first one; in a file frames have equal distances.
        stamp = capture.grab()
        ended = time.monotonic()
        if stamp is None:
            break
        frames.append((stamp, ended))
        clock.record(stamp, ended)
        t = ended - frames[0][1] if live else len(frames) / (capture.fps or FPS_UNKNOWN)

        # Decode it if it is needed.
        wanted = settled is not None and settled.wants(t)
        if counted and not wanted:
            continue
        luma = capture.retrieve()
        if luma is not None:
            contrast = max(contrast, float(luma.std()))
            if wanted and settled is not None:
                settled.add(t, capture.image(PICTURE_WIDTH_MAX))

    if not frames:
        return Probe(f"opens, but delivers no frame: {no_picture(capture)}")
    if not capture.has_image:
        return Probe(f"frames come, none can be decoded: {capture.fault}".removesuffix(": "))

    # Frame rate: of a live source as measured, of a file as declared.
    fps = capture.fps
    if live:
        arrivals = [arrival for _, arrival in frames]
        is_over = stamp is None and ended - arrivals[-1] < PROBE_SECONDS
        if is_over and (why := why_over(source, len(frames), clock)):
            return Probe(why)
        # Arrivals are too many if old frames come first, stamps if they are too slow.
        captured = [at for frame in frames if (at := clock.captured(*frame)) is not None]
        fps = min(_rate(arrivals, ended), _rate(captured or arrivals, ended))
    return Probe("", capture.codec, *capture.size, fps, remarks(capture.size, fps, contrast))


def _rate(times: Sequence[float], until: float) -> float:
    """Return the number of frames a second; of a single frame, at most as many as fit."""
    seconds = times[-1] - times[0]
    return (len(times) - 1) / seconds if seconds > 0.0 else 1.0 / max(until - times[0], 1e-3)


def _median(stack: Luma) -> Luma:
    """Return the median (H, W, ...) of a stack (N, H, W, ...)."""
    middle = len(stack) // 2
    return np.asarray(np.partition(stack, middle, axis=0)[middle], np.uint8)


def decoders() -> list[str]:
    """Return the versions of OpenCV and of its libraries that decode video, a line each."""
    video = cv2.getBuildInformation().partition("Video I/O:")[2].partition("\n\n")[0]
    return [
        f"OpenCV {cv2.__version__}",
        *(line.strip() for line in video.splitlines() if line.strip()),
    ]


def main() -> None:
    """Answer the request on standard input."""
    request = msgspec.json.decode(sys.stdin.buffer.read(), type=ProbeRequest)
    answer = Probe("no source")
    with captured_log() as ffmpeg_log:
        if request.source:
            answer = probe(request, ffmpeg_log)
        if request.detector.model and answer.detector == ModelReport():
            answer.detector = try_model(request.detector)
    sys.stdout.buffer.write(msgspec.json.encode(answer))


if __name__ == "__main__":
    main()
