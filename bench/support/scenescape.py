"""SceneScape's rendered recording of two cameras that look at one floor, as clips with truth.

The folder has Cam_*.mp4, config.json (four points of the floor in each picture and in metres, and
the lens) and gtLoc.json.gz (everybody's place on the floor in each frame). Its two people walk in a
circle and hardly leave either view, so two parts of each view are taken, which they do leave.
"""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
from msgspec import Struct, field

from bench.support.clip_variants import part_of
from bench.support.truth_clips import Clip, clip_with
from camtopod.arrays import Bools, Floats
from camtopod.records import Event, Kind

PEOPLE = {"Person": "P", "person": "Q"}
"""Names of the people, by their categories in the file."""
MIDDLE_METRES = 0.65
"""Height of the middle of a body: it enters and leaves when this crosses the border."""
LATE_FRAMES = 4
"""Frames by which the pictures are behind the places."""
FPS = 30.0
PARTS = {"Cam_x1_0": (0.55, 0.45), "Cam_x2_0": (0.4, 0.3)}
"""End of the left part of each view and beginning of the right one, shares of its width."""


class _Sensor(Struct):
    picture: list[tuple[float, float]] = field(name="camera points")
    floor: list[tuple[float, float, float]] = field(name="map points")
    intrinsics: tuple[float, float, float, float]
    width: float
    height: float

    def project(self, places: Floats) -> Floats:
        """Project places (n, 3), metres, to fractions of the picture (n, 2)."""
        fx, fy, cx, cy = self.intrinsics
        lens = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        floor, picture = np.array(self.floor), np.array(self.picture)
        _, turn, shift = cv2.solvePnP(floor, picture, lens, None, flags=cv2.SOLVEPNP_IPPE)
        points = cv2.projectPoints(places, turn, shift, lens, None)[0][:, 0]
        return np.asarray(points / (self.width, self.height), dtype=float)


class _Site(Struct):
    sensors: dict[str, _Sensor]


class _Object(Struct):
    translation: tuple[float, float, float]


class _Frame(Struct):
    objects: dict[str, list[_Object]]


def scenescape_clips(folder: Path, *, colour: bool = False) -> list[Clip]:
    """Return two parts of each view, with true events whose ``track`` is the person."""
    site = msgspec.json.decode((folder / "config.json").read_bytes(), type=_Site)
    lines = gzip.decompress((folder / "gtLoc.json.gz").read_bytes()).splitlines()
    frames = [msgspec.json.decode(line, type=_Frame) for line in lines if line]
    places = {
        person: np.array([frame.objects[name][0].translation for frame in frames])
        for name, person in PEOPLE.items()
    }
    clips = []
    for name, sensor in site.sensors.items():
        whole = clip_with(name, folder / f"{name}.mp4", [], colour=colour)
        interval = slice(round(whole.seconds * FPS))
        end, begin = PARTS[name]
        for side, part in (("left", (0.0, end)), ("right", (begin, 1.0))):
            camera = f"{name}-{side}"
            truth = [
                event
                for person, at in places.items()
                for event in _crossings(camera, person, sensor, at[interval], part)
            ]
            truth.sort(key=lambda event: event.t)
            clip = part_of(whole, "", (part[0], 0.0, part[1], 1.0))
            clips.append(replace(clip, name=camera, truth=tuple(truth)))
    return clips


def _crossings(
    camera: str, person: str, sensor: _Sensor, at: Floats, part: tuple[float, float]
) -> list[Event]:
    """Return the entries and exits of a person at places (n, 3) in a part of the view's width."""
    left, right = part
    foot, middle = sensor.project(at), sensor.project(at + np.array((0.0, 0.0, MIDDLE_METRES)))
    within = (middle >= (left, 0.0)) & (middle < (right, 1.0))
    inside: Bools = within[:, 0] & within[:, 1]
    events = []
    for k in (np.flatnonzero(np.diff(inside)) + 1).tolist():
        kind: Kind = "entry" if inside[k] else "exit"
        x, y = np.clip(((foot[k, 0] - left) / (right - left), foot[k, 1]), 0.0, 1.0).tolist()
        events.append(Event(camera, kind, (k + LATE_FRAMES) / FPS, x, y, person))
    return events
