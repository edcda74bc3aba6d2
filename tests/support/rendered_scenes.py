"""Small rendered pictures of people: textured rectangles that walk over a textured floor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from camtopod.records import Event
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

FPS = 7.0
WIDTH, HEIGHT = 192, 144
Picture = npt.NDArray[np.uint8]
Place = tuple[float, float]


@dataclass
class Person:
    """A person whose feet are at ``where(t)``, fractions of the picture (None: not there).

    ``tall`` is a fraction of the picture's height.
    """

    where: Callable[[float], Place | None]
    tall: float = 0.2
    shade: int = 60
    texture: int = 25
    """Largest difference of the cloth's patches from ``shade``, grey levels."""
    seed: int = 0


def line(start: float, a: Place, b: Place, seconds: float) -> Callable[[float], Place | None]:
    """Return a walk from ``a`` to ``b`` in ``seconds``, beginning at ``start``."""

    def where(t: float) -> Place | None:
        share = (t - start) / seconds
        return (
            (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            if 0 <= share <= 1
            else None
        )

    return where


@dataclass
class Scene:
    """A floor and the people on it."""

    people: list[Person]
    noise: float = 1.0
    light: Callable[[float], float] = lambda t: 1.0
    front: Callable[[Picture], None] = lambda picture: None
    """Draws foreground objects that hide the people."""
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def __post_init__(self) -> None:
        coarse = self.rng.uniform(60, 190, (HEIGHT // 8, WIDTH // 8)).astype(np.float32)
        self._floor = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)

    def picture(self, t: float) -> Picture:
        """Return the camera's picture at ``t``, (HEIGHT, WIDTH)."""
        picture = self._floor.copy()
        for person in sorted(self.people, key=lambda p: (p.where(t) or (0, 0))[1]):
            place = person.where(t)
            if place is not None:
                _draw(picture, person, place)
        self.front(picture)
        picture = picture * self.light(t) + self.rng.normal(0, self.noise, picture.shape)
        return np.clip(picture, 0, 255).astype(np.uint8)

    def film(self, path: Path, seconds: float) -> Path:
        """Write a video of the first ``seconds`` and return its path."""
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), FPS, (WIDTH, HEIGHT))
        for k in range(round(seconds * FPS)):
            writer.write(cv2.cvtColor(self.picture(k / FPS), cv2.COLOR_GRAY2BGR))
        writer.release()
        return path

    def events(self, seconds: float, settings: VisionSettings | None = None) -> list[Event]:
        """Return the events of a watcher in the first ``seconds``."""
        watcher = ViewPipeline("cam", settings or VisionSettings())
        events = []
        for k in range(round(seconds * FPS)):
            events += watcher.process(k / FPS, self.picture(k / FPS))
        return events + watcher.finish()


def _draw(picture: Picture, person: Person, place: Place) -> None:
    height = round(person.tall * HEIGHT)
    width = max(3, round(0.4 * height))
    left, bottom = round(place[0] * WIDTH - width / 2), round(place[1] * HEIGHT)
    cloth = (
        np.random.default_rng(person.seed)
        .integers(-person.texture, person.texture, (6, 3))
        .astype(np.float32)
    )
    cloth = person.shade + cv2.resize(cloth, (width, height), interpolation=cv2.INTER_NEAREST)
    top, right = bottom - height, left + width
    t, b, x, r = max(top, 0), min(bottom, HEIGHT), max(left, 0), min(right, WIDTH)
    if t < b and x < r:
        picture[t:b, x:r] = cloth[t - top : b - top, x - left : r - left]
