"""Describe a source after reading it for some seconds, and explain its problems.

Runs as a process of its own,

    python -m camtopod.vision.source.probe

which reads a `ProbeRequest` from standard input and writes a `Probe` to standard output, both as
JSON.
"""

from __future__ import annotations

import sys
import time
from contextlib import closing

import cv2
import msgspec
import numpy as np

from camtopod.vision.detect import DIFFERENCE_MIN, Luma
from camtopod.vision.detector.model import ModelReport, try_model
from camtopod.vision.settings import DetectorSettings, VisionSettings
from camtopod.vision.source.capture import CALL_SECONDS_MAX, PATIENCE, Frame, narrowed
from camtopod.vision.source.ffmpeg_log import FfmpegLog, captured_log
from camtopod.vision.source.live import LiveSource
from camtopod.vision.source.recorded import NO_OPTIONS, RecordedSource
from camtopod.vision.source.source_url import RETRY_SEPARATOR, kind_of

PROBE_SECONDS = 2.0
"""Time for which frames are counted."""
PROBE_SECONDS_MAX = 2.0 * CALL_SECONDS_MAX * (1.0 + PATIENCE)
"""Longest time of a probe without a picture: opening and reading, at first and with patience."""
PICTURE_WIDTH_MAX = 1280
"""Largest width (pixels) of the returned picture, which serves to draw zones on."""
SETTLE_SECONDS_MIN = 6.0
"""Least time of the pictures: slow people take some seconds to leave a place."""
SETTLE_SECONDS_MAX = 30.0
"""Time after which the best picture is taken, settled or not."""
SPACING_SECONDS = 1.0
"""Time between two frames that are kept, which take at most 3 MB each."""
UNSETTLED_SHARE_MAX = 0.002
"""Share of pixels that may be unsettled in a settled scene."""


class ProbeRequest(msgspec.Struct):
    """What to probe: a source, with the grabber's settings."""

    source: str
    settings: VisionSettings
    picture: bool = False
    """Return a picture of the scene without people, too."""
    detector: DetectorSettings = DetectorSettings()
    """Run the detector once, too, if it has a model; a source need not be given then."""


class Probe(msgspec.Struct):
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
    """Picture of a scene without its people: the median of frames over some seconds.

    A walking person covers a pixel in few of the frames, so the median shows the background. The
    scene is settled if the median of the earlier half looks as that of the later half nearly
    everywhere. A person who stands still for the whole time is part of the scene.
    """

    def __init__(self) -> None:
        self._frames: list[Frame] = []
        self.seconds = 0.0
        """Time from the first to the latest frame."""
        self.is_settled = False
        """True if the medians of both halves look the same."""

    def add(self, frame: Frame) -> None:
        """Take in a frame with an image in colour; those of another size than the first are not."""
        shape = () if frame.image is None else frame.image.shape
        if not self._frames:
            self._shape = shape
        due = not self._frames or frame.t - self._frames[-1].t >= SPACING_SECONDS
        due = due and shape == self._shape
        if due and frame.image is not None:
            self._frames.append(frame._replace(image=narrowed(frame.image, PICTURE_WIDTH_MAX)))
        self.seconds = frame.t - self._frames[0].t
        if due and self.seconds >= SETTLE_SECONDS_MIN:
            lumas = np.stack([frame.luma for frame in self._frames])
            half = len(lumas) // 2
            change = cv2.absdiff(_median(lumas[:half]), _median(lumas[half:]))
            self.is_settled = bool(np.mean(change > DIFFERENCE_MIN) <= UNSETTLED_SHARE_MAX)

    def picture(self) -> Luma:
        """Return the median of the images (H, W, 3)."""
        images = [frame.image for frame in self._frames if frame.image is not None]
        return np.stack([_median(np.stack(rows)) for rows in zip(*images, strict=True)])


def probe(request: ProbeRequest, ffmpeg_log: FfmpegLog) -> Probe:
    """Watch the source for a while, and run the detector once.

    Takes at most `PROBE_SECONDS_MAX`, with a picture plus `SETTLE_SECONDS_MAX`. Never raises for a
    source that does not work.
    """
    settled_picture = SettledPicture() if request.picture else None
    colour = request.picture or bool(request.detector.model)
    settings = request.settings
    try:
        source: RecordedSource | LiveSource
        if kind_of(request.source) == "file":
            source = RecordedSource(request.source, settings, NO_OPTIONS, colour, ffmpeg_log)
        else:
            source = LiveSource(request.source, settings, time.monotonic, ffmpeg_log, colour)
        with closing(source):
            frame = _watched(source, settled_picture)
    except OSError as error:
        return Probe(error.strerror or str(error).removeprefix(f"{request.source}: "))
    if frame is None or source.is_lost:
        reason = source.reason.partition(RETRY_SEPARATOR)[0]
        return Probe(reason.removeprefix("the source "))

    observation = source.observation
    if not observation.fps:
        observation.judge()
    result = Probe("", observation.codec, *observation.size, observation.fps, observation.remarks)
    if request.detector.model:
        result.detector = try_model(request.detector, frame.image)
    if settled_picture is not None:
        result.picture = cv2.imencode(".jpg", settled_picture.picture())[1].tobytes()
        if not settled_picture.is_settled:
            result.remarks.append(
                f"the scene has not settled within {settled_picture.seconds:.0f} s, so its picture "
                "may show people: take it again with `camtopod check --probe`"
            )
    return result


def _watched(
    source: RecordedSource | LiveSource, settled_picture: SettledPicture | None
) -> Frame | None:
    """Return the latest frame, once enough is known of the source; None if it gives none."""
    deadline = time.monotonic() + PROBE_SECONDS_MAX
    latest = None
    for frame in source.frames():
        if frame is not None:
            latest = frame
            if settled_picture is not None:
                settled_picture.add(frame)
            is_counted = source.observation.fps or source.observation.seconds >= PROBE_SECONDS
            if is_counted and (
                settled_picture is None
                or settled_picture.is_settled
                or settled_picture.seconds >= SETTLE_SECONDS_MAX
            ):
                break
        elif source.is_lost or time.monotonic() > deadline:
            break
    return latest


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
