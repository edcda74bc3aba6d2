"""A detector beside motion: what it adds to the events, and where it is not trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from coloured_scenes import FACTOR, SETTINGS, ColouredScene
from onnx_models import write_model
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Place, line

from camtopod.codec import to_json
from camtopod.records import Event
from camtopod.vision.boxes import Box, area, box_height, common_area
from camtopod.vision.detect import Blob
from camtopod.vision.detector.detector import Detector, DetectorResult
from camtopod.vision.detector.model import Detection, DetectorModel, Image as Picture
from camtopod.vision.detector.trust import Trust, objects
from camtopod.vision.pipeline import FIRST_IMAGES_PER_SECOND, Analysis, ViewPipeline
from camtopod.vision.settings import DetectorSettings, VisionSettings

SIDE_BY_SIDE = (
    Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 8.0), seed=1),
    Person(line(5.0, (-0.11, 0.7), (0.99, 0.7), 8.0), seed=2),
)
ALONE = (Person(line(5.0, (-0.05, 0.7), (1.05, 0.5), 8.0)),)
GREY = tuple(Person(person.where, shade=30, seed=person.seed) for person in SIDE_BY_SIDE)
"""The same people in colours that the models do not know."""


class Drawn:
    """A model that knows where the people of a scene are drawn, with the faults of real ones.

    late: least visible share of a person that it finds.
    missed: share of the people that it misses, at random.
    jitter: standard deviation of a box's sides (heights).
    doubled: share of the people of whom it finds the upper half as well.
    wrong: boxes of things that stand and only look like people.
    """

    size = (160, 160)
    engine = "none"

    def __init__(
        self,
        scene: ColouredScene,
        late: float = 0.5,
        missed: float = 0.0,
        jitter: float = 0.0,
        doubled: float = 0.0,
        wrong: Sequence[Box] = (),
        score: Callable[[float], float] = lambda t: 0.8,
    ) -> None:
        self._scene = scene
        self._late = late
        self._missed = missed
        self._jitter = jitter
        self._doubled = doubled
        self._wrong = wrong
        self._score = score
        self._random = np.random.default_rng(7)
        self.t = 0.0
        self.times: list[float] = []
        self.widths: set[int] = set()

    def infer(self, picture: Picture, crop: Box) -> list[Detection]:
        self.times.append(self.t)
        self.widths.add(picture.shape[1])
        found = [Detection(box, 0.5, "person") for box in self._wrong]
        image = (0.0, 0.0, float(WIDTH * FACTOR), float(HEIGHT * FACTOR))
        for box in self._scene.boxes(self.t):
            shown = common_area(box, image) / area(box)
            if shown <= self._late or self._random.random() < self._missed:
                continue
            noise = self._random.normal(0.0, self._jitter * box_height(box), 4)
            left, top, right, bottom = (
                min(max(side + error, end), far)
                for side, error, end, far in zip(
                    box, noise.tolist(), image[:2] * 2, image[2:] * 2, strict=True
                )
            )
            found.append(Detection((left, top, right, bottom), self._score(self.t), "person"))
            if self._random.random() < self._doubled:
                half = (left, top, right, (top + bottom) / 2)
                found.append(Detection(half, 0.4 * self._score(self.t), "person"))
        return found


class Timed(Detector):
    """A detector that tells its model the time."""

    def __init__(self, model: Drawn, settings: DetectorSettings) -> None:
        super().__init__(model, settings)
        self.drawn = model

    def step(self, t: float, *frame: Any) -> list[Blob] | None:
        self.drawn.t = t
        return super().step(t, *frame)


def drawn(scene: ColouredScene, rate: float = 7.0, **faults: Any) -> Timed:
    return Timed(Drawn(scene, **faults), DetectorSettings("m.onnx", looks_per_second_max=rate))


def trusted(scene: ColouredScene, rate: float = 7.0) -> Timed:
    """Return a detector that has seen the scene before."""
    earlier, later = drawn(scene), drawn(scene, rate)
    scene.events(20, earlier)
    assert earlier.trust.is_trusted
    later.trust = earlier.trust
    return later


@pytest.fixture
def detector(tmp_path: Path) -> Callable[..., Detector]:
    def make(blind: bool = False) -> Detector:
        path = write_model(tmp_path / "m.onnx", "yolox", blind=blind)
        settings = DetectorSettings(model=str(path))
        return Detector(DetectorModel(settings), settings)

    return make


def lines(events: list[Event]) -> list[bytes]:
    return [to_json(event) for event in events]


def kinds(events: list[Event]) -> list[str]:
    return [event.kind for event in events]


# --- what it adds ---------------------------------------------------------------------------------


def test_two_who_enter_side_by_side_are_two() -> None:
    scene = ColouredScene(SIDE_BY_SIDE)
    events = scene.events(20, trusted(scene))

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


def test_what_moves_and_is_no_person_is_no_event_where_the_detector_is_trusted() -> None:
    other = Person(line(16.0, (-0.05, 0.8), (1.05, 0.8), 8.0), tall=0.12, shade=20)
    assert len(ColouredScene(ALONE, [other]).events(30, None)) >= 4
    scene = ColouredScene(ALONE, [other])
    assert kinds(scene.events(30, drawn(scene))) == ["entry", "exit"]


FAULTS: dict[str, dict[str, float]] = {
    "none": {},
    "missed": {"missed": 0.2},
    "late": {"late": 0.8},
    "jitter": {"jitter": 0.03},
    "doubled": {"doubled": 0.3},
    "all": {"missed": 0.1, "late": 0.7, "jitter": 0.02, "doubled": 0.2},
}
SCENES: dict[str, tuple[Person, ...]] = {
    "crossing": (
        Person(line(5.0, (-0.05, 0.7), (1.05, 0.7), 8.0)),
        Person(line(5.0, (1.05, 0.78), (-0.05, 0.78), 8.0), seed=1),
    ),
    "group": tuple(
        Person(line(5.0 + 0.7 * k, (-0.05, 0.66 + 0.06 * k), (1.05, 0.66 + 0.06 * k), 8.0), seed=k)
        for k in range(3)
    ),
}


@pytest.mark.parametrize("faults", FAULTS)
@pytest.mark.parametrize("people", SCENES)
def test_each_enters_once_and_leaves_once_whatever_the_faults(people: str, faults: str) -> None:
    walks = SCENES[people]
    scene = ColouredScene(walks)
    events = scene.events(20, drawn(scene, **FAULTS[faults]))

    assert kinds(events) == ["entry"] * len(walks) + ["exit"] * len(walks)
    assert len({event.track for event in events}) == len(walks)
    for event in events:
        assert min(event.x, 1 - event.x) < 0.15


def test_what_stands_and_looks_like_a_person_is_no_event_while_people_pass_it() -> None:
    scene = ColouredScene(SCENES["crossing"])
    wrong = [(180.0, 150.0, 200.0, 200.0), (100.0, 20.0, 120.0, 70.0)]
    assert kinds(scene.events(20, drawn(scene, wrong=wrong))) == ["entry"] * 2 + ["exit"] * 2


def test_who_comes_in_where_somebody_leaves_is_another() -> None:
    scene = ColouredScene(
        [
            Person(line(5.0, (-0.05, 0.7), (1.1, 0.7), 8.0)),
            Person(line(13.0, (1.05, 0.72), (-0.05, 0.72), 8.0), seed=1),
        ]
    )
    events = scene.events(24, drawn(scene))
    assert kinds(events) == ["entry", "exit", "entry", "exit"]
    assert len({event.track for event in events}) == 2


def test_a_door_in_mid_view_needs_no_learning_and_no_event_is_late() -> None:
    walks = [
        Person(line(4.0, (-0.05, 0.6), (1.05, 0.6), 8.0)),
        Person(line(16.0, (-0.05, 0.7), (0.5, 0.7), 4.0), seed=1),
        Person(line(28.0, (0.5, 0.7), (1.05, 0.7), 4.0), seed=2),
    ]
    scene = ColouredScene(walks)
    told: list[tuple[float, Event]] = []
    view = ViewPipeline(
        "cam", SETTINGS, lambda one: told.extend((one.t, e) for e in one.events), drawn(scene)
    )
    events = scene.events(36, None, pipeline=view)

    assert kinds(events) == ["entry", "exit"] * 3
    assert events[3].t == pytest.approx(20.0, abs=0.3)
    assert events[3].x == pytest.approx(0.5, abs=0.05)
    assert events[4].t == pytest.approx(28.0, abs=0.5)
    assert max(t - event.t for t, event in told) < 4.0


def test_a_low_score_continues_a_track_and_begins_none() -> None:
    first, later = ALONE[0], Person(line(20.0, (-0.05, 0.8), (1.05, 0.8), 8.0), tall=0.12)
    faint = ColouredScene([first, later])

    def score(t: float) -> float:
        return 0.8 if t < 7.0 else 0.2

    assert kinds(faint.events(30, drawn(faint, score=score))) == ["entry", "exit"]


def test_a_blind_view_does_not_show_what_was_there_before() -> None:
    analyses: list[Analysis] = []
    detector = drawn(ColouredScene(()))
    pipeline = ViewPipeline("cam", VisionSettings(), analyses.append, detector)
    grey = np.full((HEIGHT, WIDTH), 90, np.uint8)
    for k in range(round(20 * FPS)):
        detector.result = DetectorResult([Detection((9.0, 9.0, 20.0, 40.0), 0.8, "person")])
        pipeline.process(k / FPS, grey)
    assert pipeline.reason
    assert analyses[-1].detector is None


def test_the_first_pictures_are_examined_too() -> None:
    """Two enter side by side before there is a background, whom motion takes for one."""
    scene = ColouredScene(
        [
            Person(line(1.0, (x, 0.7), (x + 1.1, 0.7), 8.0), seed=k)
            for k, x in enumerate((-0.05, -0.11))
        ]
    )
    assert kinds(scene.events(14, None)) == ["entry", "exit"]
    assert kinds(scene.events(14, trusted(scene))) == ["entry", "entry", "exit", "exit"]


def test_the_boxes_are_those_of_the_scene_after_the_camera_has_turned() -> None:
    """It trembles by a pixel and turns from 4 s to 8 s; one who walks to and fro is followed."""
    margin, turn = 20, 12
    scene = ColouredScene([Person(lambda t: (0.5 + 0.3 * np.sin(t / 2), 0.8), tall=0.4)])
    column, offs = 0, []

    class Shown(Drawn):
        def infer(self, picture: Picture, crop: Box) -> list[Detection]:
            return [
                detection._replace(box=tuple(np.subtract(detection.box, [FACTOR * column, 0] * 2)))
                for detection in super().infer(picture, crop)
            ]

    def observe(seen: Analysis) -> None:
        if seen.t > 12.0:
            left = scene.boxes(seen.t)[0][0] / FACTOR
            offs.extend(track.last.box[0] - left + margin for track in seen.tracks)

    turning = Timed(Shown(scene), DetectorSettings("m.onnx", looks_per_second_max=7.0))
    turning.trust = trusted(ColouredScene(ALONE)).trust
    settings = VisionSettings(working_width=WIDTH - 2 * margin)
    view = ViewPipeline("cam", settings, observe, turning)
    rng = np.random.default_rng(4)
    for k in range(round(16 * FPS)):
        t = k / FPS
        column = margin + round(turn * min(max((t - 4) / 4, 0.0), 1.0)) + int(rng.integers(-1, 2))
        columns = slice(FACTOR * column, FACTOR * (column + WIDTH - 2 * margin))
        picture = np.ascontiguousarray(scene.picture(t)[:, columns])
        view.process(t, cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), picture)
    assert len(offs) > 20
    assert abs(np.median(offs)) < 2.0


def test_a_box_ends_at_the_edge_of_what_is_shown_if_its_motion_does() -> None:
    moving = np.zeros((HEIGHT, WIDTH), np.uint8)
    moving[60:100, 20:40] = 255
    blob = Blob(20.0, 60.0, 40.0, 100.0, 30.0)
    person = Detection((24.0, 60.0, 40.0, 100.0), 0.8, "person")
    [cut_person], _ = objects([person], moving, [blob], [], (20.0, 0.0, 172.0, 144.0), 0.5)
    assert cut_person.box == blob.box


# --- where it is not trusted ---------------------------------------------------------------------


def test_a_blind_detector_changes_nothing(detector: Callable[..., Detector]) -> None:
    for people, others in ((SIDE_BY_SIDE, ()), ((), GREY)):
        blind = detector(blind=True)
        events = ColouredScene(people, others).events(14, blind)
        assert lines(events) == lines(ColouredScene(people, others).events(14, None))
        assert not blind.result.is_trusted
        assert blind.statistics()["detector_agreement"] < 0.1


@pytest.mark.parametrize(("inside", "is_trusted"), [(0.65, False), (0.75, True)])
def test_a_detector_is_trusted_that_sees_more_than_most_of_what_moves(
    inside: float, is_trusted: bool
) -> None:
    trust = Trust()
    for _ in range(500):
        trust.add(0.01, 0.01 * (1.0 - inside))
    assert trust.is_trusted == is_trusted


def test_where_agreement_falls_motion_alone_counts_again(detector: Callable[..., Detector]) -> None:
    trusted = []
    later = [
        Person(line(15.0 + 3 * k, (-0.05, 0.7), (1.05, 0.7), 7.0), tall=0.3, shade=30, seed=k)
        for k in range(8)
    ]
    both = detector()
    view = ViewPipeline("cam", SETTINGS, lambda seen: trusted.append(both.result.is_trusted), both)
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
    assert kinds(scene.events(18, rarely)) == ["entry", "exit"]
    assert len(rarely.drawn.times) <= 24
    assert rarely.statistics()["detector_looks"] == len(rarely.drawn.times)


def test_few_of_the_first_pictures_are_kept_in_colour_and_all_of_the_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = ColouredScene([Person(line(0.5, (0.1, 0.7), (1.05, 0.7), 8.0))])
    often = trusted(scene, rate=30.0)
    monkeypatch.setattr("camtopod.vision.pipeline.FIRST_IMAGES_SIDE_MAX", 240)
    view = ViewPipeline("cam", SETTINGS, None, often)
    for k in range(90):
        picture = scene.picture(k / 30)
        view.process(k / 30, cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), picture)
    view.finish()
    times = often.drawn.times
    assert 0.75 * 2.5 * FIRST_IMAGES_PER_SECOND <= len(times) <= 2.5 * FIRST_IMAGES_PER_SECOND + 1
    assert max(np.diff(times)) < 1.5 / FIRST_IMAGES_PER_SECOND
    assert often.drawn.widths == {240}
