"""Drawn clips with exact ground truth: situations that make entries and exits hard to see.

Each scene repeats one of the causes of errors on real clips: people in view at the start, two who
enter together, a crowd on stairs, cars, people seen from above, a door in mid-view, things that
sway, people who stand. They are for finding errors, not for judging how good the grabber is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.support.films import draw_person, floor
from bench.support.truth_clips import Clip, Picture
from camtopod.records import Event, Kind
from camtopod.vision.settings import VisionSettings

WIDTH, HEIGHT = 480, 360
"""Size of the pictures, pixels."""
RATE = 14.0
"""Frames a second."""
SECONDS = 40.0
"""Length of a clip."""
NOISE_SD = 2.0
"""Standard deviation of the sensor's noise, grey levels."""
_SUBPIXEL = 4
"""Fractional bits of drawing coordinates."""

Canvas = NDArray[np.uint8]
Path = Callable[[float], tuple[float, float, float]]
"""Column and row of the foot point and size, pixels, by share of the way (0 to 1)."""
Shape = Callable[[Canvas, float, float, float, float, tuple[int, ...]], None]
"""Draws an object: canvas, column, row, size, seconds on its way, colours."""


@dataclass(frozen=True)
class Mover:
    """An object on its way."""

    shape: Shape
    path: Path
    start: float
    """Seconds."""
    duration: float
    """Seconds on the way, without the halt."""
    colours: tuple[int, ...]
    tall: float = 1.0
    """Height over size."""
    halt: tuple[float, float] | None = None
    """Time at which it stops, and for how long, seconds."""

    @property
    def end(self) -> float:
        """Time at which it has gone its way, seconds."""
        return self.start + self.duration + (self.halt[1] if self.halt else 0.0)

    def walked(self, t: float) -> float:
        """Return the seconds that it has moved by time ``t``."""
        if self.halt and t > self.halt[0]:
            t = max(self.halt[0], t - self.halt[1])
        return t - self.start

    def at(self, t: float) -> tuple[float, float, float]:
        """Return foot point and size at time ``t``."""
        return self.path(self.walked(t) / self.duration)

    def draw(self, canvas: Canvas, t: float) -> None:
        """Draw it as it is at time ``t``."""
        if self.start <= t <= self.end:
            x, y, size = self.at(t)
            self.shape(canvas, x, y, size, self.walked(t), self.colours)

    def truth(self) -> list[Event]:
        """Return its events: its middle crosses the border, or it appears in mid-view."""
        times = np.arange(max(0.0, self.start), min(SECONDS, self.end), 0.02)
        seen = []
        for t in times.tolist():
            x, y, size = self.at(t)
            if 0 <= x <= WIDTH and 0 <= y - 0.5 * self.tall * size <= HEIGHT:
                seen.append(t)
        events: list[tuple[Kind, float]] = []
        if seen and seen[0] > 0.3:
            events.append(("entry", seen[0]))
        if seen and seen[-1] < SECONDS - 0.3:
            events.append(("exit", seen[-1]))
        places = [(kind, t, self.at(t)) for kind, t in events]
        return [
            Event("cam", kind, t, min(max(x / WIDTH, 0.0), 1.0), min(max(y / HEIGHT, 0.0), 1.0))
            for kind, t, (x, y, _) in places
        ]


# -- shapes ------------------------------


def person(
    canvas: Canvas, x: float, y: float, size: float, t: float, colours: tuple[int, ...]
) -> None:
    """Draw a walking person of height ``size``."""
    draw_person(canvas, x, y, size, 0.12 * float(np.sin(2 * np.pi * t)), colours)


def car_from_the_side(
    canvas: Canvas, x: float, y: float, size: float, t: float, colours: tuple[int, ...]
) -> None:
    """Draw a car of length ``size``."""
    rear = ((-0.5, 0.04), (-0.5, 0.18), (-0.34, 0.22), (-0.2, 0.35))
    body = (*rear, (0.15, 0.36), (0.3, 0.22), (0.5, 0.16), (0.5, 0.04))
    _fill(canvas, x, y, size, body, colours[:3])
    _fill(
        canvas, x, y, size, ((-0.28, 0.22), (-0.17, 0.33), (0.13, 0.33), (0.25, 0.22)), (60, 50, 45)
    )
    for wheel in (-0.3, 0.3):
        middle = _fixed(x + wheel * size), _fixed(y - 0.05 * size)
        cv2.circle(canvas, middle, _fixed(0.08 * size), (30, 30, 30), -1, cv2.LINE_AA, _SUBPIXEL)


def car_from_the_front(
    canvas: Canvas, x: float, y: float, size: float, t: float, colours: tuple[int, ...]
) -> None:
    """Draw a car of width ``size``."""
    body = ((-0.5, 0.04), (-0.5, 0.4), (-0.36, 0.76), (0.36, 0.76), (0.5, 0.4), (0.5, 0.04))
    _fill(canvas, x, y, size, body, colours[:3])
    _fill(canvas, x, y, size, ((-0.4, 0.44), (-0.31, 0.7), (0.31, 0.7), (0.4, 0.44)), (70, 60, 55))
    _fill(canvas, x, y, size, ((-0.3, 0.12), (-0.3, 0.22), (0.3, 0.22), (0.3, 0.12)), (40, 40, 40))


def person_from_above(
    canvas: Canvas, x: float, y: float, size: float, t: float, colours: tuple[int, ...]
) -> None:
    """Draw shoulders of width ``size`` and a head."""
    middle = _fixed(x), _fixed(y)
    axes = _fixed(0.5 * size), _fixed(0.3 * size)
    cv2.ellipse(canvas, middle, axes, 0, 0, 360, colours[:3], -1, cv2.LINE_AA, _SUBPIXEL)
    cv2.circle(canvas, middle, _fixed(0.17 * size), colours[3:], -1, cv2.LINE_AA, _SUBPIXEL)


def balloon(
    canvas: Canvas, x: float, y: float, size: float, t: float, colours: tuple[int, ...]
) -> None:
    """Draw a balloon of height ``size`` that sways."""
    x, y = x + 0.2 * size * float(np.sin(1.3 * t)), y + 0.3 * size * float(np.sin(0.9 * t))
    axes = _fixed(0.4 * size), _fixed(0.5 * size)
    cv2.ellipse(canvas, (_fixed(x), _fixed(y)), axes, 0, 0, 360, colours[:3], -1, cv2.LINE_AA, 4)


def _fixed(value: float) -> int:
    return round(value * (1 << _SUBPIXEL))


def _fill(
    canvas: Canvas,
    x: float,
    y: float,
    size: float,
    corners: tuple[tuple[float, float], ...],
    colour: tuple[int, ...],
) -> None:
    points = [[_fixed(x + a * size), _fixed(y - b * size)] for a, b in corners]
    cv2.fillPoly(canvas, [np.array(points, np.int32)], colour, cv2.LINE_AA, _SUBPIXEL)


# -- scenes ------------------------------


def line(
    x0: float, y0: float, x1: float, y1: float, size: float, last: float | None = None
) -> Path:
    """Return a straight path; the size changes from ``size`` to ``last``."""
    grown = (size if last is None else last) - size
    return lambda share: (x0 + share * (x1 - x0), y0 + share * (y1 - y0), size + share * grown)


class Scenes:
    """Draws the scenes at random, from a seed."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def start(self) -> list[Mover]:
        """People in view at the start, some of them slow."""
        present = [self._crossing(-self._between(2, 16), 20.0) for _ in range(5)]
        return present + [self._crossing(self._between(2, SECONDS)) for _ in range(6)]

    def pairs(self) -> list[Mover]:
        """Two who walk side by side all the way."""
        movers = []
        for t in self._times(4, 3.5, 7):
            one = self._crossing(t)
            (x0, y0, size), (x1, y1, _) = one.path(0.0), one.path(1.0)
            gap = self._between(0.22, 0.45) * size * (1 if x1 < x0 else -1)
            path = line(x0 + gap, y0, x1 + gap, y1, size * self._between(0.92, 1.05))
            movers += [one, Mover(person, path, t, one.duration, self._colours())]
        return movers

    def stairs(self) -> list[Mover]:
        """People abreast who come nearer, or go away."""
        movers = []
        for t in self._times(1, 2, 4.5):
            x, down = self._between(0.3, 0.6) * WIDTH, self._between(0, 1) < 0.5
            for number in range(int(self._between(1, 4))):
                near = x + number * self._between(0.1, 0.16) * HEIGHT
                ends = (
                    (0.9 * near + 0.05 * WIDTH, 0.1 * HEIGHT, 0.18 * HEIGHT),
                    (near, 1.45 * HEIGHT, 0.42 * HEIGHT),
                )
                a, b = ends if down else ends[::-1]
                path = line(a[0], a[1], b[0], b[1], a[2], b[2])
                movers.append(Mover(person, path, t + self._between(0, 0.5), 8.0, self._colours()))
        return movers

    def road(self) -> list[Mover]:
        """Cars that cross in a second or two, and two walkers."""
        cars = [self._car(t, self._between(1.2, 2.4)) for t in self._times(4, 1.2, 4)]
        return cars + [self._crossing(self._between(4, 30), 9.0, 0.97 * HEIGHT) for _ in range(2)]

    def highway(self) -> list[Mover]:
        """Cars that come from the horizon, and cars that go there."""
        movers = []
        for t in self._times(4, 0.9, 3):
            lane = int(self._between(0, 3))
            far, near = (0.42 + 0.05 * lane) * WIDTH, (0.1 + 0.35 * lane) * WIDTH
            size, away = 0.34 * WIDTH * self._between(0.85, 1.2), lane == 2

            def path(
                share: float,
                far: float = far,
                near: float = near,
                size: float = size,
                away: bool = away,
            ) -> tuple[float, float, float]:
                v = (1.0 - share if away else share) ** 2.2
                return far + v * (near - far), (0.22 + 1.13 * v) * HEIGHT, 0.05 * WIDTH + v * size

            movers.append(
                Mover(car_from_the_front, path, t, self._between(2, 3.5), self._colours(), 0.8)
            )
        return movers

    def from_above(self) -> list[Mover]:
        """People seen from above, who cross in all directions."""
        movers = []
        for t in self._times(3, 1.5, 4):
            angle, x, y = (
                self._between(0, 6.28),
                self._between(0.3, 0.7) * WIDTH,
                self._between(0.3, 0.7) * HEIGHT,
            )
            dx, dy = 0.62 * WIDTH * np.cos(angle), 0.62 * WIDTH * np.sin(angle)
            path = line(x - dx, y - dy, x + dx, y + dy, 0.11 * WIDTH)
            movers.append(
                Mover(person_from_above, path, t, self._between(7, 11), self._colours(), 0.0)
            )
        return movers

    def door(self) -> list[Mover]:
        """People who come out of a door in mid-view or go in; some stand on the way."""
        movers = []
        for t in self._times(3, 3, 6):
            side, size = (-0.1 if self._between(0, 1) < 0.5 else 1.1) * WIDTH, 0.3 * HEIGHT
            ends = (0.42 * WIDTH, 0.55 * HEIGHT, size), (side, 0.8 * HEIGHT, 1.25 * size)
            a, b = ends if self._between(0, 1) < 0.5 else ends[::-1]
            halt = (
                (t + self._between(2, 3.5), self._between(5, 12))
                if self._between(0, 1) < 0.3
                else None
            )
            path = line(a[0], a[1], b[0], b[1], a[2], b[2])
            movers.append(Mover(person, path, t, self._between(5, 8), self._colours(), halt=halt))
        return movers

    def balloons(self) -> list[Mover]:
        """Balloons that sway, and people who walk past in front of them."""
        swaying = [
            Mover(balloon, line(x, 160, x, 160, 44), -1.0 - k, 200.0, self._colours())
            for k, x in enumerate((255, 277, 299, 321))
        ]
        walkers = self._times(3, 4, 8)
        return swaying + [
            self._crossing(t, row=self._between(0.72, 0.95) * HEIGHT) for t in walkers
        ]

    def queue(self) -> list[Mover]:
        """People of whom most stand for a while."""
        movers = []
        for t in self._times(3, 3, 6):
            halt = (
                (t + self._between(2, 4), self._between(6, 20))
                if self._between(0, 1) < 0.6
                else None
            )
            movers.append(self._crossing(t, halt=halt))
        return movers

    def car_park(self) -> list[Mover]:
        """Cars of which some park, and walkers."""
        movers = []
        for k, t in enumerate(range(3, 38, 7)):
            halt = (t + self._between(2, 3), SECONDS) if k % 2 else None
            movers.append(self._car(float(t), 6.0, halt))
        return movers + [self._crossing(self._between(4, 30)) for _ in range(3)]

    # Parts of scenes.

    def _between(self, low: float, high: float) -> float:
        return float(self._rng.uniform(low, high))

    def _times(self, first: float, low: float, high: float) -> Iterator[float]:
        """Yield times, seconds, ``low`` to ``high`` apart."""
        t = first
        while t < SECONDS - 4.0:
            yield t
            t += self._between(low, high)

    def _colours(self) -> tuple[int, ...]:
        return tuple(self._rng.integers(10, 240, 6).tolist())

    def _crossing(
        self,
        start: float,
        duration: float | None = None,
        row: float | None = None,
        halt: tuple[float, float] | None = None,
    ) -> Mover:
        """Return a walker from one side to the other; those further down are taller."""
        row = self._between(0.5, 0.97) * HEIGHT if row is None else row
        size = 0.12 * HEIGHT + 0.28 * row
        a, b = (-0.2 * size, WIDTH + 0.2 * size)[:: 1 if self._between(0, 1) < 0.5 else -1]
        duration = self._between(6, 11) if duration is None else duration
        return Mover(
            person, line(a, row, b, row, size), start, duration, self._colours(), halt=halt
        )

    def _car(self, start: float, duration: float, halt: tuple[float, float] | None = None) -> Mover:
        """Return a car that crosses from the left, or nearer from the right."""
        near = self._between(0, 1) < 0.5
        size = (0.3 if near else 0.22) * WIDTH * self._between(0.85, 1.3)
        a, b = (-0.6 * size, WIDTH + 0.6 * size)[:: -1 if near else 1]
        row = (0.8 if near else 0.62) * HEIGHT + self._between(-8, 8)
        path = line(a, row, b, row, size)
        return Mover(car_from_the_side, path, start, duration, self._colours(), 0.36, halt)


SCENES: dict[str, Callable[[Scenes], list[Mover]]] = {
    "people in view at the start": Scenes.start,
    "two who enter together": Scenes.pairs,
    "stairs": Scenes.stairs,
    "a road": Scenes.road,
    "a highway": Scenes.highway,
    "people from above": Scenes.from_above,
    "a door in mid-view": Scenes.door,
    "balloons": Scenes.balloons,
    "people who stand": Scenes.queue,
    "a car park": Scenes.car_park,
}


def drawn_clips(seeds: int) -> list[Clip]:
    """Return each scene drawn from ``seeds`` seeds."""
    return [_clip(f"drawn: {name}, {seed}", name, seed) for name in SCENES for seed in range(seeds)]


def _clip(title: str, name: str, seed: int) -> Clip:
    movers = SCENES[name](Scenes(seed))
    # Things that sway make no events.
    truth = [event for mover in movers if mover.shape is not balloon for event in mover.truth()]

    def pictures(skipped: int, settings: VisionSettings) -> Iterator[Picture]:
        step = max(1, round(RATE / settings.analysed_fps))
        for frame, picture in enumerate(_pictures(movers, seed)):
            if frame >= skipped and (frame - skipped) % step == 0:
                yield Picture(frame / RATE, picture)

    return Clip(
        title,
        "",
        tuple(sorted(truth, key=lambda event: event.t)),
        WIDTH / HEIGHT,
        SECONDS,
        RATE,
        VisionSettings(),
        pictures,
    )


def _pictures(movers: list[Mover], seed: int) -> Iterator[NDArray[np.uint8]]:
    """Yield the luma (H, W) of every frame; those who are further down are in front."""
    rng = np.random.default_rng(seed)
    empty = floor(WIDTH, HEIGHT, seed)
    noise = [rng.normal(0, NOISE_SD, (HEIGHT, WIDTH)).round().astype(np.int8) for _ in range(8)]
    ordered = sorted(movers, key=lambda mover: mover.path(0.5)[1])
    for frame in range(round(SECONDS * RATE)):
        canvas = empty.copy()
        for mover in ordered:
            mover.draw(canvas, frame / RATE)
        grey = cv2.cvtColor(cv2.GaussianBlur(canvas, (3, 3), 0.6), cv2.COLOR_BGR2GRAY)
        yield np.asarray(cv2.add(grey, noise[int(rng.integers(8))], dtype=cv2.CV_8U), np.uint8)
