"""Hard shadows, pictures larger than the view, pauses, beacons, and doors that swing."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Picture, Place, Scene, line

from camtopod.vision.detect.blank_areas import blank_pixels
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

WALKERS = [
    Person(line(6.0, (-0.05, 0.8), (1.05, 0.8), 6.0), tall=0.35, seed=1),
    Person(line(16.0, (1.05, 0.9), (-0.05, 0.9), 6.0), tall=0.35, seed=2),
]
SECONDS = 26.0


class Shaded(Scene):
    """Each person throws two thin hard shadows, longer than the person is high."""

    def picture(self, t: float) -> Picture:
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        for person in self.people:
            if (place := person.where(t)) is not None:
                foot = round(place[0] * WIDTH), round(place[1] * HEIGHT) - 1
                length = 1.3 * person.tall * HEIGHT
                for side in (-1, 1):
                    end = round(foot[0] + side * length), round(foot[1] - 0.5 * length)
                    cv2.line(mask, foot, end, (255,), 5)
        front, self.front = self.front, lambda picture: None
        picture = super().picture(t)
        self.front = front
        floor = cv2.resize(self._floor, (WIDTH, HEIGHT))
        is_floor = np.abs(picture.astype(np.float32) - floor) < 6.0
        picture[(mask > 0) & is_floor] //= 2
        return picture


def kinds(scene: Scene, seconds: float = SECONDS) -> list[str]:
    return [event.kind for event in scene.events(seconds)]


def test_who_throws_hard_shadows_is_seen() -> None:
    assert kinds(Shaded(WALKERS)) == ["entry", "exit"] * 2


@pytest.mark.parametrize(("shade", "texture"), [(40, 5), (40, 25), (60, 15)])
def test_who_walks_at_dusk_is_counted_once(shade: int, texture: int) -> None:
    """In a third of the light a person is seen in parts, whose heights are no person's."""

    class Dusk(Scene):
        def picture(self, t: float) -> Picture:
            return np.asarray(cv2.GaussianBlur(super().picture(t), (5, 5), 0), np.uint8)

    ways = ((-0.05, 0.8), (1.05, 0.8)), ((1.05, 0.9), (-0.05, 0.9))
    people = [
        Person(line(6.0 + 10.0 * k, *ways[k % 2], 6.0), 0.4, shade, texture, seed=k)
        for k in range(6)
    ]
    dusk = Dusk(people, noise=0.5, light=lambda t: 0.3)
    assert kinds(dusk, 70.0) == ["entry", "exit"] * 6


@pytest.mark.parametrize("seconds", [0.15, 1.5])
@pytest.mark.parametrize("darkness", [0.25, 0.3])
def test_a_lamp_that_lights_the_scene_four_times_as_much_makes_no_events(
    darkness: float, seconds: float
) -> None:
    """A dark scene has few grey levels, from which those of the bright one are computed."""
    walking = Scene(
        WALKERS, light=lambda t: float(np.interp(t, [7.5, 7.5 + seconds], [darkness, 1.0]))
    )
    assert kinds(walking) == ["entry", "exit"] * 2


def barred(share: float, level: int) -> Scene:
    """Return a scene with bars at both sides of the picture that show nothing."""
    width = round(share * WIDTH)

    def bars(picture: Picture) -> None:
        picture[:, :width] = picture[:, WIDTH - width :] = level

    return Scene(WALKERS, noise=0.0, front=bars)


@pytest.mark.parametrize(("share", "level"), [(0.08, 0), (0.15, 16), (0.25, 30)])
def test_the_edge_of_a_picture_between_bars_is_the_edge_of_the_view(
    share: float, level: int
) -> None:
    events = barred(share, level).events(SECONDS)
    assert [event.kind for event in events] == ["entry", "exit"] * 2
    for event, x in zip(events, (share, 1 - share, 1 - share, share), strict=True):
        assert event.x == pytest.approx(x, abs=0.12)


def circle(picture: Picture) -> None:
    """Leave the picture of a fisheye lens in the middle, 9/16 as high as the picture is wide."""
    radius = WIDTH * 9 / 32
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    picture[(x - WIDTH / 2) ** 2 + (y - HEIGHT / 2) ** 2 > radius**2] = 0


def quarter(picture: Picture) -> None:
    """Take away the upper left one of four tiles."""
    picture[: HEIGHT // 2, : WIDTH // 2] = 0


@pytest.mark.parametrize(
    ("front", "a", "b"),
    [
        *[(circle, (x, y), (1 - x, y)) for x, y in ((0.26, 0.3), (0.23, 0.6), (0.27, 0.75))],
        (circle, (0.4, 0.86), (0.6, 0.17)),
        (quarter, (1.0, 0.45), (0.5, 0.45)),
        (quarter, (0.2, 1.0), (0.2, 0.5)),
        (quarter, (0.0, 0.85), (1.0, 0.85)),
        (quarter, (0.75, 1.0), (0.75, 0.0)),
    ],
)
def test_what_is_shown_at_all_is_the_view(
    front: Callable[[Picture], None], a: Place, b: Place
) -> None:
    """People pass from one edge of what is shown, at a foot point, to another, and back.

    Of many rows and columns less than half is shown.
    """
    a_out, b_out = (
        (p[0] + 0.3 * (p[0] - q[0]), p[1] + 0.3 * (p[1] - q[1])) for p, q in ((a, b), (b, a))
    )
    there, back = line(5.0, a_out, b_out, 8.0), line(15.0, b_out, a_out, 8.0)
    people = [Person(there, 0.15, shade=20, seed=1), Person(back, 0.15, shade=235, seed=2)]
    events = Scene(people, noise=0.0, front=front).events(26.0)
    assert [event.kind for event in events] == ["entry", "exit"] * 2
    for event, (x, y) in zip(events, (a, b, b, a), strict=True):
        assert (event.x, event.y) == pytest.approx((x, y), abs=0.15)


@pytest.mark.parametrize("seconds", [0.1, 10.0])
def test_who_walks_where_the_picture_was_black_at_first_is_counted(seconds: float) -> None:
    """The upper half is as dark as a side of a yard at night, then it has light."""

    class Yard(Scene):
        def picture(self, t: float) -> Picture:
            picture = super().picture(t)
            light = np.interp(t, [20.0, 20.0 + seconds], [0.01, 1.0])
            picture[: HEIGHT // 2] = (picture[: HEIGHT // 2] * light).astype(np.uint8)
            return picture

    people = [
        Person(line(t, (-0.05, y), (1.05, y), 6.0), 0.2, seed=seed)
        for seed, (t, y) in enumerate([(6.0, 0.9), (45.0, 0.9), (55.0, 0.4)])
    ]
    assert kinds(Yard(people, noise=0.3), 65.0) == ["entry", "exit"] * 3


def test_a_text_or_headlights_where_nothing_is_shown_change_nothing() -> None:
    scene, pipeline = barred(0.15, 16), ViewPipeline("cam", VisionSettings())
    for k in range(round(30 * FPS)):
        picture = scene.picture(k / FPS)
        if k / FPS > 8.0:
            picture[:20, :20] = 200
        if 10.0 < k / FPS < 16.0:
            picture[:, :28] = 90
        pipeline.process(k / FPS, picture)
    assert pipeline.statistics()["relearned"] == 0


def test_what_shows_nothing_is_blank() -> None:
    rng = np.random.default_rng(3)
    frames = [rng.normal(30, 3, (90, 160)).clip(0, 255).astype(np.uint8) for _ in range(9)]
    assert not blank_pixels(frames).any()  # the dark has noise
    for frame in frames:
        frame[:20] = 16
        frame[:, 150:] = 90
        cv2.circle(frame, (80, 60), 12, (10,), cv2.FILLED)  # at no border
    blank = blank_pixels(frames) > 0
    assert blank[:20, :150].all()
    assert not blank[20:].any()
    assert not blank_pixels([np.zeros((90, 160), np.uint8)] * 3).any()  # a covered lens
    ground = Scene([], noise=0.0, light=lambda t: 0.1).picture(0.0)  # a codec drops the noise
    assert not blank_pixels([ground] * 9).any()


@pytest.mark.parametrize("pause", [2.5, 6.0, 100.0])
def test_who_left_just_before_a_pause_has_left(pause: float) -> None:
    """They are at the border in the last frame but a few."""
    scene, pipeline = Scene(WALKERS[:1]), ViewPipeline("cam", VisionSettings())
    events = []
    for k in range(round(SECONDS * FPS)):
        t = k / FPS
        if t < 12.6 or t > 12.6 + pause:
            events += pipeline.process(t, scene.picture(t))
    [entry, leaving] = events + pipeline.finish()
    assert (entry.kind, leaving.kind) == ("entry", "exit")
    assert leaving.t == pytest.approx(11.9, abs=0.8)


@pytest.mark.parametrize("pause", [2.5, 6.0])
@pytest.mark.parametrize("way", [((-0.05, 0.8), (1.05, 0.8)), ((1.05, 0.8), (-0.05, 0.8))])
def test_who_is_at_the_border_when_the_frames_pause_has_left_or_entered(
    way: tuple[Place, Place], pause: float
) -> None:
    """One comes in as a pause ends; another goes out as one begins."""
    people = [
        Person(line(t, *way, 6.0), tall=0.35, seed=seed) for seed, t in enumerate((8.9, 19.0))
    ]
    scene, pipeline = Scene(people), ViewPipeline("cam", VisionSettings())
    events = []
    for k in range(round((27.0 + pause) * FPS)):
        t = k / FPS
        if not (9.5 - pause < t < 9.5 or 24.6 < t < 24.6 + pause):
            events += pipeline.process(t, scene.picture(t))
    events += pipeline.finish()
    assert [event.kind for event in events] == ["entry", "exit"] * 2
    for event, t in zip(events, (9.2, 14.6, 19.3, 24.7), strict=True):
        assert event.t == pytest.approx(t, abs=0.6)


def test_a_lamp_that_goes_round_is_said_to_blind_the_camera() -> None:
    def lamp(t: float) -> Picture:
        picture = scene.picture(t).astype(np.float32)
        x = np.arange(WIDTH) - WIDTH * (0.5 + 0.5 * np.cos(5.0 * t))
        return np.clip(picture * (1.0 + np.exp(-((x / 40.0) ** 2))), 0, 255).astype(np.uint8)

    scene, pipeline = Scene([]), ViewPipeline("cam", VisionSettings())
    for k in range(round(8 * FPS)):
        pipeline.process(k / FPS, scene.picture(k / FPS))
    assert pipeline.reason == ""
    for k in range(round(8 * FPS), round(30 * FPS)):
        pipeline.process(k / FPS, lamp(k / FPS))
    assert "light changes large parts" in pipeline.reason
    for k in range(round(30 * FPS), round(50 * FPS)):
        pipeline.process(k / FPS, scene.picture(k / FPS))
    assert pipeline.reason == ""
