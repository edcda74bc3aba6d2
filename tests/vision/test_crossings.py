"""Where objects leave the view: at borders that cut them, and at those of what an image shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from rendered_scenes import FPS, WIDTH as PICTURE_WIDTH, Person, Scene, line

from camtopod.records import Event
from camtopod.vision.boxes import Box, union
from camtopod.vision.detect import Blob
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings
from camtopod.vision.track import Crossings, Decision, FrameView, IgnoredAreas, Tracker

WIDTH, HEIGHT = 320, 240
WHOLE: Box = (0.0, 0.0, WIDTH, HEIGHT)


class Watcher:
    """A tracker of one view, 320 x 240 pixels, that is told the boxes in each image."""

    def __init__(self, view: Box = WHOLE) -> None:
        """Begin with an empty view; ``view`` is the part of the scene that images show."""
        ignored = IgnoredAreas(np.full((HEIGHT, WIDTH), 255, np.uint8))
        self.decisions: list[Decision] = []
        self.crossings = Crossings("cam", WIDTH, HEIGHT, (), ignored, self.decisions.append)
        self.crossings.begin(0.0, ignored)
        self._view = view
        self.frame = FrameView(0.0, view)
        self.tracker = Tracker(VisionSettings(), self.crossings, iter(range(1, 1000)))
        self._count = 0
        self.see([[]] * 10)

    def see(self, images: Sequence[Sequence[Box]]) -> list[Event]:
        """Return the events that are certain after images with these boxes."""
        events = []
        for boxes in images:
            blobs = [Blob(*map(float, box), (box[0] + box[2]) / 2) for box in boxes]
            self.frame = FrameView(self._count / FPS, self._view)
            events += self.tracker.step(self.frame, blobs)
            self._count += 1
        return events

    def edges(self) -> list[tuple[str, str | None]]:
        """Return reason and edge of each decision about an object."""
        reasons = ("entered", "left", "in mid-view", "beside others", "lost", "occluded")
        return [(one.reason, one.edge) for one in self.decisions if one.reason in reasons]


def passage(images: Sequence[Sequence[Box]], view: Box = WHOLE) -> list[tuple[str, str | None]]:
    """Return what the beginnings and ends of objects in some images were taken for."""
    watcher = Watcher(view)
    watcher.see([*images, *[[]] * 20])
    return watcher.edges()


# --- bodies that the top border cuts -------------------------------------------------------------


def upwards(bottoms: Sequence[float]) -> list[list[Box]]:
    """Return the boxes of somebody seen from above, 80 pixels tall, by the place of the feet."""
    return [[(140.0, max(0.0, bottom - 80), 170.0, bottom)] for bottom in bottoms]


UP = [float(bottom) for bottom in range(HEIGHT + 60, 60, -5)]
"""From below the view until the top border cuts a fifth, 5 pixels in each image: 35 a second."""


def test_who_is_cut_by_the_top_border_on_the_way_up_has_left() -> None:
    """The feet are last seen 50 pixels below it, which is more than they walk in 0.6 s."""
    assert passage(upwards([*UP, 60, 55, 50])) == [
        ("entered", "bottom border"),
        ("left", "top border"),
    ]


def test_who_comes_down_from_the_top_border_has_entered() -> None:
    way = upwards([*UP, 60, 55, 50])[::-1]
    assert passage(way) == [("entered", "top border"), ("left", "bottom border")]


def test_whose_head_alone_is_cut_by_the_top_border_has_not_left() -> None:
    assert passage(upwards(UP)) == [("entered", "bottom border"), ("lost", None)]


def test_who_turns_back_at_the_top_border_has_not_left() -> None:
    """Cut to half and down again: lost behind something on the way down."""
    way = upwards([*UP, 55, 50, 45, 40, 35, *np.linspace(35, 58, 17)])
    assert passage(way) == [("entered", "bottom border"), ("lost", None)]


def test_who_is_hidden_from_the_waist_down_on_the_way_up_has_not_left() -> None:
    """Nor is a short box below the border one that the border cuts."""
    way = upwards(range(HEIGHT + 60, 140, -5))
    way += [[(140.0, top, 170.0, top + 45)] for top in (60, 55, 50)]
    assert passage(way) == [("entered", "bottom border"), ("lost", None)]


# --- outlines that jump to a border --------------------------------------------------------------


def halting(ahead: float, width: float, height: float) -> list[list[Box]]:
    """Return the boxes of what comes in at the left and halts ``ahead`` of the right border."""
    stop = WIDTH - ahead
    rights = [*np.arange(20.0, stop, 16.0), *[stop] * 20]
    return [[(max(0.0, right - width), 200 - height, right, 200.0)] for right in rights]


@pytest.mark.parametrize(("width", "height"), [(40.0, 100.0), (150.0, 60.0), (24.0, 60.0)])
def test_an_outline_that_jumps_by_less_than_half_a_size_is_the_same_object(
    width: float, height: float
) -> None:
    size = max(height, 0.7 * width)
    for share, is_other in ((0.3, False), (0.45, False), (0.55, True), (0.9, True)):
        ahead = share * size
        watcher = Watcher()
        watcher.see(halting(ahead, width, height))
        (track,) = watcher.tracker.active
        at_border = (WIDTH - width, 200 - height, float(WIDTH), 200.0)
        assert watcher.crossings.comes_in(watcher.frame, track, at_border) == is_other, share


def test_a_car_that_halts_and_starts_fast_is_one_passage() -> None:
    """From 40 pixels ahead of the border to the border at once."""
    images = halting(40, 150, 60)
    images += [[(left, 140.0, float(WIDTH), 200.0)] for left in (180, 230, 280)]
    assert passage(images) == [("entered", "left border"), ("left", "right border")]


def test_who_comes_in_beside_somebody_who_stands_is_another() -> None:
    """Both are in one blob at first; it reaches to the border by more than half of a size."""
    stands = halting(60, 40, 80)
    inside = stands[-1][0]
    watcher = Watcher()
    watcher.see(stands)
    (track,) = watcher.tracker.active
    for x in (12, 20, 28):
        watcher.see([[union(inside, (float(WIDTH - x), 125.0, float(WIDTH), 205.0))]])
        assert track.last.box == inside
    assert len(watcher.tracker.active) == 2


# --- borders of what an image shows ---------------------------------------------------------------

PART: Box = (24.0, 20.0, WIDTH - 28.0, HEIGHT - 32.0)
"""Each side is farther inside of the scene's own than a slow object may be from a border."""
SLOW = np.arange(0.0, 140.0, 2.0)
"""Ways in pixels, 14 a second: 8.4 in 0.6 s, less than the margin of 10 pixels."""


def cut(box: Box, view: Box) -> Box:
    """Return the part of a box that is in a view, at least a pixel wide and high."""
    left, top = min(max(box[0], view[0]), view[2] - 1), min(max(box[1], view[1]), view[3] - 1)
    right, bottom = max(min(box[2], view[2]), left + 1), max(min(box[3], view[3]), top + 1)
    return (left, top, right, bottom)


@pytest.mark.parametrize(
    ("edge", "x", "y"),
    [("left", -1, 0), ("right", 1, 0), ("top", 0, -1), ("bottom", 0, 1)],
)
def test_who_leaves_at_a_border_of_the_view_has_left(edge: str, x: int, y: int) -> None:
    """Comes in there, and leaves there after a turn; half of the body is seen first and last, or
    the feet at the top.
    """
    starts = {"left": (24, 120), "right": (292, 120), "top": (160, -2), "bottom": (160, 208)}
    middle_x, middle_y = starts[edge]
    way: list[list[Box]] = []
    for far in [*SLOW[:45], *SLOW[44::-1]]:
        a, b = middle_x - far * x, middle_y - far * y
        way.append([cut((a - 15, b - 30, a + 15, b + 30), PART)])
    expected = [("entered", f"{edge} border"), ("left", f"{edge} border")]
    assert passage(way, PART) == expected

    assert passage(way) != expected, "a view of the whole scene has no border there"


def test_sizes_do_not_shrink_where_the_view_cuts() -> None:
    watcher = Watcher(PART)
    right = PART[2]
    watcher.see([[(x, 100.0, min(x + 40.0, right), 180.0)] for x in np.arange(150.0, right, 5.0)])
    (track,) = watcher.tracker.active
    assert track.width == pytest.approx(40.0, abs=1.0)


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_outlines_jump_to_the_border_of_the_view(share: float) -> None:
    right = PART[2]
    ahead = share * 80.0
    watcher = Watcher(PART)
    stop = right - ahead
    rights = [*np.arange(64.0, stop, 16.0), *[stop] * 20]
    watcher.see([[(max(PART[0], end - 40), 100.0, end, 180.0)] for end in rights])
    (track,) = watcher.tracker.active
    assert watcher.crossings.comes_in(watcher.frame, track, (right - 40, 100.0, right, 180.0)) == (
        share > 0.5
    )


def test_who_enters_a_view_where_another_has_just_left_is_another() -> None:
    """Two passages of people who meet at the right border, as in `test_tracker`."""

    def at(x: float, width: int, bottom: float) -> Box:
        return cut((x - width, bottom - 2.5 * width, x, bottom), PART)

    end = PART[2] + 10
    images = [[at(x, 20, 150)] for x in np.arange(PART[0] + 15, end, 5)]
    images += [[at(x, 26, 170)] for x in np.arange(end, PART[0], -14)]
    reasons = [reason for reason, _ in passage(images, PART)]
    assert sorted(reasons) == ["entered", "entered", "left", "left"]


def test_an_event_at_a_border_of_the_view_is_placed_and_dated_there() -> None:
    watcher = Watcher(PART)
    right = PART[2]
    middles = np.arange(50.0, right, 5.0)
    images = [[cut((x - 20, 100.0, x + 20, 180.0), PART)] for x in middles]
    *_, leaving = watcher.see([*images, *[[]] * 20])
    assert leaving.x is not None
    assert leaving.x * WIDTH == pytest.approx(right, abs=10.0)
    assert leaving.t == pytest.approx((10 + len(images)) / FPS, abs=0.3)


TURN = 12
"""Pixels by which the camera turns at most, less than a sway may be."""
MARGIN = 20
"""Pixels of the drawn picture around what the camera shows at rest."""


def turned(people: list[Person], turn: int, seconds: float) -> list[tuple[str, str | None]]:
    """Return what people are taken for whom a camera sees that turns slowly by ``turn`` pixels.

    It trembles by a pixel, turns from 4 s to 8 s, and stays.
    """
    scene, decisions = Scene(people), []
    pipeline = ViewPipeline("cam", VisionSettings(), lambda seen: decisions.extend(seen.decisions))
    rng = np.random.default_rng(4)
    for k in range(round(seconds * FPS)):
        t = k / FPS
        x = MARGIN + round(turn * min(max((t - 4) / 4, 0.0), 1.0)) + int(rng.integers(-1, 2))
        columns = slice(x, x + PICTURE_WIDTH - 2 * MARGIN)
        pipeline.process(t, np.ascontiguousarray(scene.picture(t)[:, columns]))
    pipeline.finish()
    return [(one.reason, one.edge) for one in decisions if one.edge or one.reason == "lost"]


@pytest.mark.parametrize(("turn", "edge"), [(-TURN, "right border"), (TURN, "left border")])
def test_who_leaves_the_view_of_a_camera_that_has_turned_has_left(turn: int, edge: str) -> None:
    """The walk is slow and ends where the scene goes on, but the images do not."""
    out = 1.0 if turn < 0 else 0.0
    border = (MARGIN + out * (PICTURE_WIDTH - 2 * MARGIN) + turn) / PICTURE_WIDTH
    beyond = border + (0.1 if turn < 0 else -0.1)
    comes = line(10.0, (0.5, 1.25), (0.5, 0.8), 5.0)
    goes = line(15.0, (0.5, 0.8), (beyond, 0.8), 10.0)
    walker = Person(lambda t: comes(t) or goes(t), shade=20)
    assert turned([walker], turn, 32.0) == [("entered", "bottom border"), ("left", edge)]


# --- doors in mid-view ---------------------------------------------------------------------------


def across(y: float, until: float = WIDTH) -> list[list[Box]]:
    """Return the boxes of a person of 20 x 50 pixels who walks from the left border."""
    return [[(max(0.0, x - 20), y - 50, min(x, WIDTH), y)] for x in np.arange(6.0, until, 6.0)]


@pytest.mark.parametrize(("passages", "edge"), [(0, "learned door"), (6, None)])
def test_a_place_that_more_walk_through_than_vanish_at_is_no_door(
    passages: int, edge: str | None
) -> None:
    """Three vanish in mid-view; the third by a door, unless others have walked on there."""
    watcher = Watcher()
    gone: list[list[Box]] = [[]] * 20
    watcher.see([*across(180, 160), *gone] * 2)
    watcher.see([*across(180), *gone] * passages)
    watcher.see([*across(180, 160), *gone])
    assert watcher.edges()[-1] == ("left" if edge else "lost", edge)
