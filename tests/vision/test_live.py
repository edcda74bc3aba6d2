"""Events of live streams whose stamps, clocks and pictures are not as they should be."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from rendered_scenes import Person, Scene, line

from camtopod.records import Event
from camtopod.vision import pipeline
from camtopod.vision.grabber import Grabber
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source import capture, live, probe
from camtopod.vision.source.capture import Capture, Frame
from camtopod.vision.source.ffmpeg_log import FfmpegLog
from camtopod.vision.source.remarks import Observed, Playback

FPS = 7.0
SECONDS = 11.0
WALKS = [
    Person(line(2.0, (-0.05, 0.55), (1.05, 0.5), 3.0), tall=0.3),
    Person(line(6.0, (1.05, 0.9), (-0.05, 0.95), 3.0), tall=0.3, seed=4),
]
PICTURE = cache(Scene(WALKS).picture)
"""The scene at a time; the same one for all tests, as drawing it takes long."""
TRUTH = [("entry", 2.1), ("exit", 4.9), ("entry", 6.1), ("exit", 8.9)]
"""Kind and time of the events, seconds: of who is half inside."""


class Camera:
    """Stands in for `Capture`: sends a scene by a clock that waits for the analysis alone."""

    is_open = True
    size = (192, 144)
    is_jpeg = False
    is_often_damaged = False
    fps = FPS
    seconds = 0.0
    fault = ""
    codec = "H.264"
    film_seconds = SECONDS
    needs_patience = False
    """True if it gives nothing without patience."""
    parts = float("inf")
    """Number of pictures until one whose part is not described as usual."""
    rewinds = False
    """True if each connection begins at the beginning."""
    burst = 1
    """Number of pictures that arrive at once."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        stamp: Callable[[float], float] = lambda t: t,
        fps: float = FPS,
        pictures: float = float("inf"),
    ) -> None:
        """Stamp each picture with ``stamp`` of its time, seconds.

        pictures: number of them in a connection.
        """
        self.now = 1000.0
        self.fps = fps
        self.left = self.pictures = pictures
        self.patience: list[bool] = []
        self.readers: list[bool] = []
        """For each connection, whether JPEG was read without its parts' descriptions."""
        self.t = 0.0
        self.sent = 0
        self.stamp = stamp
        self.picture = PICTURE
        self.is_over = False
        self.idle: Callable[[], bool] = lambda: True
        self.closed = threading.Event()
        monkeypatch.setattr(live, "Capture", self.opened)
        monkeypatch.setattr(live, "time", SimpleNamespace(monotonic=lambda: self.now))

    def opened(self, source: str, *others: object) -> Camera:
        self.left = self.pictures
        self.t *= not self.rewinds
        self.patience.append(bool(others[-2]))
        self.readers.append(bool(others[-1]))
        return self

    def grab(self) -> float | None:
        while not self.idle():
            time.sleep(0.0002)
        self.is_over |= self.t >= self.film_seconds
        if self.is_over:
            self.closed.wait()
        if self.closed.is_set() or not self.left:
            return None
        if self.needs_patience and not self.patience[-1]:
            if self.size != (0, 0):
                self.now += capture.CALL_SECONDS_MAX
            return None
        if not self.readers[-1] and self.pictures - self.left >= self.parts:
            return None
        self.left -= 1
        if self.sent % self.burst == 0:
            self.now += self.burst / self.fps
        self.sent += 1
        self.t += 1 / self.fps
        if self.burst > 1 and self.sent % self.burst == 1:
            return 0.0  # a decoder that was kept waiting forgets the stamp
        return self.stamp(self.t)

    def frame(self) -> Frame | None:
        return Frame(0.0, self.picture(self.t))

    def release(self) -> None:
        pass


def grabber_of(
    camera: Camera, source: str = "http://192.0.2.1/s", wall_clock: Callable[[], float] = time.time
) -> Grabber:
    grabber = Grabber("cam", source, wall_clock=wall_clock)
    assert isinstance(grabber._source, live.LiveSource)
    camera.idle = grabber._source._queue.empty
    camera.closed = grabber._source._stop
    return grabber


def reason_of(grabber: Grabber, said: str) -> str:
    """Return the grabber's state as soon as its reason says this."""
    for _ in grabber.events():
        if said in grabber.reason:
            state = grabber.state
            grabber.close()
            return state
    raise AssertionError(grabber.reason)


def seen(camera: Camera, grabber: Grabber) -> list[Event]:
    """Return the events of the camera's film."""
    events = []
    for event in grabber.events():
        if event is not None:
            events.append(event)
        if camera.is_over:
            break
    grabber.close()
    return sorted(events, key=lambda event: event.t)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "BOOTSTRAP_SECONDS", 1.0)
    monkeypatch.setattr(live, "BACKOFF_SECONDS_MAX", 0.05)
    monkeypatch.setattr(live, "HEARTBEAT_SECONDS", 0.01)


@pytest.mark.parametrize(
    "stamp",
    [
        lambda t: t,
        lambda t: 0.0,
        lambda t: 0.84 * t,
        lambda t: t / 90,
        lambda t: FPS * t / 25,
        lambda t: 90 * t,
        lambda t: min(t, 3.0),
        lambda t: t + 86400 * (3.0 <= t < 3.1),
        lambda t: t if t < 4.0 else t - 86400,
        lambda t: t + 86400 * (t < 0.5),
        lambda t: t + 86400 * (t > 0.5),
    ],
    ids=[
        "right",
        "none",
        "21-as-25",
        "1-kHz-as-90",
        "counted",
        "fast",
        "stuck",
        "ahead",
        "behind",
        "falls",
        "rises",
    ],
)
def test_events_have_the_times_of_arrivals_where_stamps_lie(
    stamp: Callable[[float], float], monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(monkeypatch, stamp)

    grabber = grabber_of(camera, wall_clock=lambda: 5000.0 + camera.t)

    events = seen(camera, grabber)

    assert [event.kind for event in events] == [kind for kind, _ in TRUTH]
    assert [event.t - 5000.0 for event in events] == pytest.approx([t for _, t in TRUTH], abs=0.7)


@pytest.mark.parametrize(("step", "at"), [(-2.0, 5.5), (3600.0, 5.5), (-3600.0, 3.5)])
def test_events_go_on_at_the_new_time_when_the_clock_is_set(
    step: float, at: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(monkeypatch, lambda t: t)

    grabber = grabber_of(
        camera, wall_clock=lambda: 5000.0 + camera.t + (step if camera.t > at else 0.0)
    )

    events = seen(camera, grabber)

    truth = [5000.0 + t + (step if t > at else 0.0) for _, t in TRUTH]
    assert [event.t for event in events] == pytest.approx(sorted(truth), abs=0.7)


def test_pictures_that_come_in_bursts_are_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "QUEUE_FRAMES", 2)
    camera = Camera(monkeypatch)
    camera.burst = 14
    camera.picture = cache(Scene(WALKS[1:]).picture)
    grabber = grabber_of(camera, wall_clock=lambda: 4000.0 + camera.now)
    camera.idle = lambda: True

    events = seen(camera, grabber)

    assert [event.kind for event in events] == ["entry", "exit"]
    assert events[1].t - events[0].t == pytest.approx(TRUTH[3][1] - TRUTH[2][1], abs=0.4)
    assert grabber.statistics()["frames_dropped"] < 25, "of 77"


def test_what_is_no_stream_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    snapshot = Camera(monkeypatch, pictures=1)
    assert reason_of(grabber_of(snapshot), "a single picture") == "connecting"

    film = Camera(monkeypatch)
    film.seconds = 26.0
    assert reason_of(grabber_of(film), "a recording, not a stream: download it") == "connecting"
    assert film.left == film.pictures, "nothing was read"

    film = Camera(monkeypatch, lambda t: 20 * t, pictures=9)  # a server that tells no length
    reason_of(grabber_of(film), "a recording, not a stream: download it")


def test_a_recorder_s_playback_is_not_told_as_if_it_happened_now(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    film = Camera(monkeypatch)
    film.seconds = 26.0
    said = "a recording, not a stream: make a file of it by ffmpeg"
    assert reason_of(grabber_of(film, "rtsp://192.0.2.1/tracks/101"), said) == "connecting"
    assert film.left == film.pictures, "nothing was read"

    film = Camera(monkeypatch)
    source = "rtsp://192.0.2.1/cam/playback?channel=1&starttime=2026_01_01_10_00_00"
    assert reason_of(grabber_of(film, source), said) == "connecting"
    assert film.left == film.pictures

    film = Camera(monkeypatch, pictures=SECONDS * FPS + 2)  # whose length nobody tells
    film.film_seconds = float("inf")
    film.rewinds = True
    grabber = grabber_of(film, "rtsp://192.0.2.1/tracks/101")
    assert reason_of(grabber, said) == "stalled"
    assert len(film.patience) == 2
    assert grabber.statistics()["entries"] <= 2, "each is told once"


@pytest.mark.parametrize("seconds", [4.0, 12.0])
def test_a_camera_whose_sessions_end_is_no_recording(
    seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(monkeypatch, pictures=seconds * FPS)
    camera.film_seconds = 40.0
    for picture, rewinds in ((PICTURE(1.0), False), (None, seconds < 10.0)):
        camera.t, camera.is_over, camera.rewinds = 0.0, False, rewinds
        camera.picture = PICTURE if picture is None else lambda t, picture=picture: picture
        camera.film_seconds = float("inf")
        grabber = grabber_of(camera, "rtsp://192.0.2.1/s")
        for _ in grabber.events():
            assert "recording" not in grabber.reason
            if grabber.statistics()["connections"] >= 4 and grabber.state == "running":
                break
        grabber.close()


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("onvif://192.0.2.1", "`camtopod init` asks a camera for its streams by ONVIF"),
        ("v4l2:///dev/video0", "give a device by its number"),
        ("rstp://192.0.2.1/s", "rstp:// is none of rtsp, "),
        ("4242", "/dev/video4242 does not exist"),
        ("/dev/v4l/by-id/usb-unplugged-index0", "cannot be opened: No such file or directory"),
    ],
)
def test_a_source_that_no_stream_can_come_from_is_said_at_once(source: str, said: str) -> None:
    grabber = Grabber("cam", source, wall_clock=time.time)
    assert reason_of(grabber, said) == "connecting"
    shown = probe.probe(probe.ProbeRequest(source, VisionSettings()), FfmpegLog())
    assert said in shown.problem


@pytest.mark.parametrize("fps", [1 / 5, 1 / 15])
def test_a_stream_is_waited_for_as_long_as_its_frames_take(
    fps: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(monkeypatch, fps=fps)
    camera.film_seconds = 400.0
    camera.needs_patience = True
    grabber = grabber_of(camera)

    assert reason_of(grabber, "people cannot be followed") == "running"

    assert camera.patience == [False, True]
    assert grabber.statistics()["frames_analysed"] > 5


def test_a_probe_measures_a_stream_and_has_as_much_patience(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera = Camera(monkeypatch)
    camera.film_seconds = float("inf")
    camera.needs_patience = True

    seen = probe.probe(probe.ProbeRequest("http://192.0.2.1/s", VisionSettings()), FfmpegLog())

    assert (seen.problem, seen.codec, (seen.width, seen.height)) == ("", "H.264", camera.size)
    assert seen.fps == pytest.approx(FPS, rel=0.01)
    assert camera.patience == [False, True]


def test_a_stream_whose_size_is_unknown_is_opened_with_more_patience(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera = Camera(monkeypatch)
    camera.size = (0, 0)
    camera.pictures = 0
    assert reason_of(grabber_of(camera), "data come, but no keyframe yet") == "connecting"

    camera.pictures = float("inf")
    camera.needs_patience = True
    assert len(seen(camera, grabber_of(camera))) == len(TRUTH)


def test_what_was_not_decoded_is_neither_frozen_nor_without_contrast(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera = Camera(monkeypatch)
    observed = Observed(cast(Capture, camera), VisionSettings())
    observed.add(0.0, camera.picture(0.0))
    for k in range(1, 100):
        observed.add(k / FPS, None)
    assert observed.remarks == []

    camera.is_often_damaged = True
    observed.judge()
    assert observed.remarks == [
        "frames are damaged again and again, as when packets are lost: use TCP, or set the camera "
        "to shorter keyframe distances"
    ]


@pytest.mark.parametrize("parts", [0, 9])
def test_jpeg_pictures_are_read_whatever_their_parts_say(
    parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(monkeypatch, pictures=10**9)
    camera.is_jpeg = True
    camera.parts = parts

    assert len(seen(camera, grabber_of(camera))) == len(TRUTH)
    assert camera.readers == [False, True]
    assert camera.patience == [False, False]


def test_jpeg_has_no_keyframes_to_wait_for(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = Camera(monkeypatch, pictures=0)
    camera.is_jpeg = True
    camera.size = (0, 0)
    grabber = grabber_of(camera)
    assert reason_of(grabber, "no JPEG picture comes: give another URL") == "connecting"

    shown = probe.probe(probe.ProbeRequest("http://192.0.2.1/s", VisionSettings()), FfmpegLog())
    assert "no JPEG picture comes" in shown.problem
    assert camera.readers[-2:] == [False, True], "both ways were tried"


def test_pictures_that_show_nothing_do_not_make_a_recording() -> None:
    black = np.full((9, 9), 16, np.uint8)
    pictures = np.random.default_rng(1).integers(0, 255, (4, 9, 9), np.uint8)
    playback = Playback()
    playback.begin()
    assert not any(playback.repeats(k * 8.0, luma) for k, luma in enumerate([black, *pictures]))

    playback.begin()
    assert not playback.repeats(100.0, black)
    assert playback.repeats(100.1, pictures[0]), "what was played before begins with it"


def test_the_end_waits_for_no_frame_of_a_burst(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = Camera(monkeypatch)
    camera.burst = 14
    grab = camera.grab
    monkeypatch.setattr(camera, "grab", lambda: None if grab() is None else camera.t)
    source = live.LiveSource("http://192.0.2.1/s", VisionSettings(), lambda: camera.now)
    waits: list[float] = []

    def put(frame: Frame, timeout: float) -> None:
        waits.append(timeout)
        source._stop.set()  # while the first one waits

    monkeypatch.setattr(source._queue, "put", put)
    source._run()

    assert waits == pytest.approx([2.0], abs=0.3)


def test_pictures_that_are_not_looked_at_are_no_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = Camera(monkeypatch)
    camera.film_seconds = 60.0
    settings = VisionSettings(analysed_fps=1 / 9)
    source = live.LiveSource("http://192.0.2.1/s", settings, lambda: camera.now)
    camera.closed = source._stop
    reasons: set[str] = set()
    monkeypatch.setattr(source, "_lose", lambda reason, is_lost=True: reasons.add(reason))

    frames = (frame for frame in source.frames() if frame is not None)
    times = [next(frames).t for _ in range(4)]
    source.close()

    assert np.diff(times) == pytest.approx(9.0, abs=0.2)
    assert not reasons


def test_pictures_that_are_none_or_do_not_change_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = Camera(monkeypatch)
    monkeypatch.setattr(camera, "frame", lambda: None)
    camera.fault = "damaged video"
    said = "frames come, none can be decoded: damaged video"
    assert reason_of(grabber_of(camera), said) == "connecting"

    camera = Camera(monkeypatch)
    camera.film_seconds = 2 * SECONDS
    frozen = Frame(0.0, camera.picture(0.0))
    monkeypatch.setattr(camera, "frame", lambda: frozen)
    assert reason_of(grabber_of(camera), "is the camera frozen?") == "running"
