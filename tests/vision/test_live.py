"""Events of live streams whose stamps, clocks and pictures are not as they should be."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from rendered_scenes import Person, Scene, line

from camtopod.records import Event
from camtopod.vision import pipeline
from camtopod.vision.grabber import Grabber
from camtopod.vision.source import live
from camtopod.vision.source.capture import Frame

FPS = 7.0
SECONDS = 11.0
WALKS = [
    Person(line(2.0, (-0.05, 0.55), (1.05, 0.5), 3.0), tall=0.3),
    Person(line(6.0, (1.05, 0.9), (-0.05, 0.95), 3.0), tall=0.3, seed=4),
]
TRUTH = [("entry", 2.1), ("exit", 4.9), ("entry", 6.1), ("exit", 8.9)]
"""Kind and time of the events, seconds: of who is half inside."""


class Camera:
    """Stands in for `Capture`: sends a scene by a clock that waits for the analysis alone."""

    is_open = True
    size = (192, 144)
    codec = "H.264"
    seconds = 0.0
    fault = ""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, stamp: Callable[[float], float]) -> None:
        """Stamp each picture with ``stamp`` of its time, seconds."""
        self.now = 1000.0
        self.began = self.now
        self.stamp = stamp
        self.scene = Scene(WALKS)
        self.is_over = False
        self.idle: Callable[[], bool] = lambda: True
        monkeypatch.setattr(live, "Capture", lambda *_, **__: self)
        monkeypatch.setattr(live, "time", SimpleNamespace(monotonic=lambda: self.now))

    @property
    def t(self) -> float:
        return self.now - self.began

    def grab(self) -> float | None:
        while not self.idle():
            time.sleep(0.0002)
        self.is_over = self.t >= SECONDS
        if self.is_over:
            return None
        self.now += 1 / FPS
        return self.stamp(self.t)

    def frame(self) -> Frame | None:
        return Frame(0.0, self.scene.picture(self.t))

    def release(self) -> None:
        pass


def seen(camera: Camera, wall_clock: Callable[[], float]) -> list[Event]:
    """Return the events of the camera's film."""
    grabber = Grabber("cam", "rtsp://192.0.2.1/s", wall_clock=wall_clock)
    assert isinstance(grabber._source, live.LiveSource)
    camera.idle = grabber._source._queue.empty
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
    ],
    ids=["right", "none", "21 as 25", "1 kHz as 90", "counted", "fast", "stuck", "ahead", "behind"],
)
def test_events_have_the_times_of_arrivals_where_stamps_lie(
    stamp: Callable[[float], float], monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(monkeypatch, stamp)

    events = seen(camera, lambda: 5000.0 + camera.t)

    assert [event.kind for event in events] == [kind for kind, _ in TRUTH]
    assert [event.t - 5000.0 for event in events] == pytest.approx([t for _, t in TRUTH], abs=0.7)


@pytest.mark.parametrize(
    ("step", "at"), [(-3600.0, 5.5), (-2.0, 5.5), (3600.0, 5.5), (-3600.0, 3.5)]
)
def test_events_go_on_at_the_new_time_when_the_clock_is_set(
    step: float, at: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(monkeypatch, lambda t: t)

    events = seen(camera, lambda: 5000.0 + camera.t + (step if camera.t > at else 0.0))

    truth = [5000.0 + t + (step if t > at else 0.0) for _, t in TRUTH]
    assert [event.t for event in events] == pytest.approx(sorted(truth), abs=0.7)
