"""A detector beside motion: what it adds to the events, and where it is not trusted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from coloured_scenes import FACTOR, SETTINGS, ColouredScene
from onnx_models import write_model
from rendered_scenes import HEIGHT, WIDTH, Person, Place, line

from camtopod.codec import to_json
from camtopod.records import Event
from camtopod.vision.boxes import Box
from camtopod.vision.detect import Blob
from camtopod.vision.detector.detector import Detector
from camtopod.vision.detector.fusion import TrackedBox
from camtopod.vision.detector.model import Detection, Image as Picture, Model
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import DetectorSettings

SIDE_BY_SIDE = (
    Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 8.0), seed=1),
    Person(line(5.0, (-0.11, 0.7), (0.99, 0.7), 8.0), seed=2),
)
ALONE = (Person(line(5.0, (-0.05, 0.7), (1.05, 0.5), 8.0)),)
GREY = tuple(Person(person.where, shade=30, seed=person.seed) for person in SIDE_BY_SIDE)
"""The same people in colours that the models do not know."""


class Drawn:
    """A model that knows where the people of a scene are drawn.

    late: least visible share of a person that it finds.
    """

    size = (160, 160)

    def __init__(self, scene: ColouredScene, late: float = 0.0) -> None:
        self._scene, self._late = scene, late
        self.t = 0.0
        self.times: list[float] = []
        self.parts: list[Box] = []

    def infer(self, picture: Picture, part: Box) -> list[Detection]:
        self.times.append(self.t)
        self.parts.append(part)
        found = []
        for left, top, right, bottom in self._scene.boxes(self.t):
            x, y = max(left, 0), max(top, 0)
            r, b = min(right, WIDTH * FACTOR), min(bottom, HEIGHT * FACTOR)
            shown = max(0, r - x) * max(0, b - y) / ((right - left) * (bottom - top))
            middle = part[0] <= (x + r) / 2 <= part[2] and part[1] <= (y + b) / 2 <= part[3]
            if shown > self._late and middle:
                found.append(Detection((x, y, r, b), 0.8, "person"))
        return found


class Timed(Detector):
    """A detector that tells its model the time."""

    def __init__(self, model: Drawn, settings: DetectorSettings) -> None:
        super().__init__(model, settings)
        self.drawn = model

    def step(
        self,
        t: float,
        picture: Picture,
        moving: Picture,
        blobs: list[Blob],
        known: list[TrackedBox],  # type: ignore[override]
    ) -> list[Blob]:
        self.drawn.t = t
        return super().step(t, picture, moving, blobs, known)


def drawn(scene: ColouredScene, late: float = 0.5, rate: float = 7.0) -> Timed:
    return Timed(Drawn(scene, late), DetectorSettings("m.onnx", looks_per_second_max=rate))


@pytest.fixture
def detector(tmp_path: Path) -> Callable[..., Detector]:
    def make(blind: bool = False) -> Detector:
        path = write_model(tmp_path / "m.onnx", "yolox", blind=blind)
        settings = DetectorSettings(model=str(path))
        return Detector(Model(settings), settings)

    return make


def lines(events: list[Event]) -> list[bytes]:
    return [to_json(event) for event in events]


def kinds(events: list[Event]) -> list[str]:
    return [event.kind for event in events]


# --- what it adds ---------------------------------------------------------------------------------


def test_two_who_enter_side_by_side_are_two() -> None:
    scene = ColouredScene(SIDE_BY_SIDE)
    events = scene.events(20, drawn(scene))

    assert kinds(events) == ["entry", "entry", "exit", "exit"]
    assert len({event.track for event in events}) == 2
    for entry in events[:2]:
        assert entry.t == pytest.approx(5.3, abs=0.8), "motion dates the entries"
        assert entry.x == pytest.approx(0.0, abs=0.1)


def test_a_model_splits_two_who_enter_side_by_side(detector: Callable[..., Detector]) -> None:
    apart = (
        Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 8.0), seed=1),
        Person(line(5.3, (-0.05, 0.66), (1.05, 0.66), 8.0), seed=2),
    )
    events = ColouredScene(apart).events(20, detector())

    assert kinds(events) == ["entry", "entry", "exit", "exit"]
    assert len({event.track for event in events}) == 2


def test_whoever_stands_is_held_while_others_pass() -> None:
    def where(t: float) -> Place | None:
        if t < 9:
            return line(5.0, (-0.05, 0.7), (0.5, 0.7), 4.0)(t)
        return (0.5, 0.7) if t < 30 else line(30.0, (0.5, 0.7), (1.05, 0.7), 4.0)(t)

    people = [
        Person(where),
        Person(line(12.0, (-0.05, 0.75), (1.05, 0.75), 8.0), seed=1),
        Person(line(21.0, (1.05, 0.72), (-0.05, 0.72), 8.0), seed=2),
    ]
    scene = ColouredScene(people)
    events = scene.events(38, drawn(scene))
    assert kinds(events) == ["entry", "entry", "exit", "entry", "exit", "exit"]
    first, last = events[0], events[-1]
    assert first.track == last.track
    assert last.t == pytest.approx(34.0, abs=0.6)


# --- where it is not trusted ---------------------------------------------------------------------


def test_a_blind_detector_changes_nothing(detector: Callable[..., Detector]) -> None:
    for people, others in ((SIDE_BY_SIDE, ()), ((), GREY)):
        blind = detector(blind=True)
        events = ColouredScene(people, others).events(14, blind)
        assert lines(events) == lines(ColouredScene(people, others).events(14, None))
        assert not blind.result.trusted
        assert blind.statistics()["detector_agreement"] < 0.1


def test_where_agreement_falls_motion_alone_counts_again(detector: Callable[..., Detector]) -> None:
    trusted = []
    later = [
        Person(line(15.0 + 3 * k, (-0.05, 0.7), (1.05, 0.7), 7.0), tall=0.3, shade=30, seed=k)
        for k in range(8)
    ]
    both = detector()
    view = ViewPipeline("cam", SETTINGS, lambda seen: trusted.append(both.result.trusted), both)
    events = ColouredScene(ALONE, later).events(50, both, pipeline=view)

    assert any(trusted)
    assert not trusted[-1]
    assert sum(event.t > 35 for event in events) >= 4, "people that it does not see"


# --- inferences ----------------------------------------------------------------------------------------


def test_inference_runs_only_when_something_moves_and_not_too_often() -> None:
    scene = ColouredScene(ALONE)
    often = drawn(scene)
    scene.events(18, often)
    assert 35 <= len(often.drawn.times) <= 70
    assert min(often.drawn.times) >= 4.9
    assert max(often.drawn.times) <= 15.5

    scene = ColouredScene(ALONE)
    rarely = drawn(scene, rate=2.0)
    scene.events(18, rarely)
    assert len(rarely.drawn.times) <= 24
    assert rarely.statistics()["detector_looks"] == len(rarely.drawn.times)


# --- fusion ---------------------------------------------------------------------------------------
