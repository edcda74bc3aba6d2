"""Rendered scenes in colour, in which the models of `onnx_models` find the people."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from onnx_models import draw_person
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Picture, Scene

from camtopod.records import Event
from camtopod.vision.detector.detector import Detector
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import VisionSettings

FACTOR = 2
"""Size of the picture in colour, in sizes of the working picture."""
SETTINGS = VisionSettings(working_width=WIDTH)


class ColouredScene:
    """People in the models' colours, and others in grey, on a grey floor."""

    def __init__(self, people: Sequence[Person], others: Sequence[Person] = ()) -> None:
        self._scene = Scene(list(others))
        self._people = people

    def boxes(self, t: float) -> list[tuple[int, int, int, int]]:
        """Return the people's boxes at ``t`` (seconds), pixels of the picture in colour."""
        boxes = []
        for person in self._people:
            place = person.where(t)
            if place is not None:
                height = round(person.tall * HEIGHT * FACTOR)
                width = round(0.4 * height)
                left = round(place[0] * WIDTH * FACTOR - width / 2)
                bottom = round(place[1] * HEIGHT * FACTOR)
                boxes.append((left, bottom - height, left + width, bottom))
        return boxes

    def picture(self, t: float) -> Picture:
        """Return the picture at ``t`` (seconds), (H, W, 3): blue, green, red."""
        grey = self._scene.picture(t)
        size = (WIDTH * FACTOR, HEIGHT * FACTOR)
        large = cv2.resize(grey, size, interpolation=cv2.INTER_NEAREST)
        picture = np.repeat(large[:, :, None], 3, axis=2)
        for box in sorted(self.boxes(t), key=lambda box: box[3]):
            draw_person(picture, box)
        return picture

    def events(
        self,
        seconds: float,
        detector: Detector | None,
        settings: VisionSettings = SETTINGS,
        pipeline: ViewPipeline | None = None,
    ) -> list[Event]:
        """Return the events of the first ``seconds``, in order of time."""
        view = pipeline or ViewPipeline("cam", settings, None, detector)
        events = []
        for k in range(round(seconds * FPS)):
            picture = self.picture(k / FPS)
            luma = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            events += view.process(k / FPS, luma, picture)
        return sorted(events + view.finish(), key=lambda event: event.t)
