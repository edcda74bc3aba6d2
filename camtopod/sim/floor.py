"""Small site of the demo: floor plan, cameras, people who walk through it, and the ground truth.

Coordinates of the plan are metres, x to the east and y to the north. The ground truth (zones,
links, transit times) is read off the recorded walks: who was in which view when, and on which path
they entered and left it.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np

from camtopod.arrays import Floats, Longs
from camtopod.sim.truth import TRUTH_SCHEMA, Truth, pairs_of, walked_links, zone_at

WIDTH, HEIGHT = 192, 144
"""Size of the cameras' pictures, pixels."""
FPS = 7.0
"""Frames per second."""
PERSON_METRES, SHOULDER_METRES = 1.75, 0.2
"""Height and half the width of a person, metres."""
STEP_METRES = 0.1
"""Distance of the points of a route."""
WALKING_SPEED, SPEED_SD = 1.35, 0.2
"""Median speed (metres per second) and its spread (log scale)."""
KEEP_RIGHT_METRES, LANE_SD_METRES = 0.2, 0.3
"""Mean and standard deviation of the distance to the right of the middle of a path."""
WARM_UP_SECONDS = 60.0
"""People start this long before the recording, so that it begins with people under way."""


@dataclass(frozen=True)
class View:
    """Camera on a pole that looks at ``target`` (x, y) from ``distance`` metres away.

    ``heading`` (radians) is the direction of view on the plan, ``height`` is in metres.
    """

    camera: str
    target: tuple[float, float]
    heading: float = math.pi / 2
    height: float = 8.0
    distance: float = 5.0
    focal: float = 1.15
    """Focal length as a multiple of the picture's width."""

    def project(self, points: Floats) -> Floats:
        """Project world points (n, 3) to (n, 3): x and y as fractions of the picture, depth in
        metres.
        """
        ahead = np.array((math.cos(self.heading), math.sin(self.heading), 0.0))

        # Camera axes.
        position = (
            np.array((*self.target, 0.0)) - self.distance * ahead + np.array((0, 0, self.height))
        )
        forward = np.array((*self.target, 0.0)) - position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)

        # Perspective projection.
        camera_points = (points - position) @ np.stack([right, down, forward], axis=1)
        depth = np.maximum(camera_points[:, 2], 1e-3)
        x = 0.5 + self.focal * camera_points[:, 0] / depth
        y = 0.5 + self.focal * (WIDTH / HEIGHT) * camera_points[:, 1] / depth
        return np.column_stack([x, y, camera_points[:, 2]])

    def feet(self, floor: Floats) -> Floats:
        """Project floor points (n, 2) to picture fractions and depth, (n, 3)."""
        return self.project(np.column_stack([floor, np.zeros(len(floor))]))

    def sees(self, floor: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return for people at floor points (n, 2) whether any part of the body is in the
        picture.
        """
        x, y, depth = self.feet(floor).T
        head_x, head_y, _ = self.project(
            np.column_stack([floor, np.full(len(floor), PERSON_METRES)])
        ).T
        half = self.focal * SHOULDER_METRES / np.maximum(depth, 1e-3)
        left, right = np.minimum(x, head_x) - half, np.maximum(x, head_x) + half
        result: np.ndarray[tuple[int], np.dtype[np.bool_]] = (
            (right > 0) & (left < 1) & (y > 0) & (head_y < 1) & (depth > 0)
        )
        return result

    def footprint(self) -> Floats:
        """Return the corners of the floor that is in the picture, (4, 2) metres."""
        square = np.array([(-3, -3), (3, -3), (3, 3), (-3, 3)], float) + self.target
        picture_points = self.feet(square)[:, :2].astype(np.float32)
        corners = np.array([[(0, 0), (1, 0), (1, 1), (0, 1)]], float)
        homography = cv2.getPerspectiveTransform(picture_points, square.astype(np.float32))
        floor: Floats = cv2.perspectiveTransform(corners, homography)[0].astype(float)
        return floor


Floor = Literal["wood", "stone", "brick", "grass"]
"""Kind of floor."""


@dataclass(frozen=True)
class Area:
    """Rectangle of floor: west, south, east, north in metres."""

    floor: Floor
    box: tuple[float, float, float, float]


@dataclass(frozen=True)
class Plan:
    """Floor plan: places (metres; corners, too), paths between them (pairs of names), floor,
    cameras.
    """

    places: dict[str, tuple[float, float]]
    ways: list[tuple[str, str]]
    areas: list[Area]
    views: list[View]

    def around(self, place: str) -> list[str]:
        """Return the places that a path joins to ``place``, in the order of the paths."""
        return [a for way in self.ways if place in way for a in way if a != place]


@dataclass(frozen=True)
class Walk:
    """One person's walk: ``t`` (n,) seconds since the start, ``floor`` (n, 2) metres, ``way`` (n,)
    path.
    """

    t: Floats
    floor: Floats
    way: Longs


@dataclass(frozen=True)
class FloorPassage:
    """One person's passage through a view.

    Times are seconds since the start, positions of the feet are fractions of the picture,
    ``way_in`` and ``way_out`` are the numbers of the paths on which the person enters and leaves.
    """

    camera: str
    walker: int
    t_in: float
    t_out: float
    at_in: tuple[float, float]
    at_out: tuple[float, float]
    way_in: int
    way_out: int


def demo_plan() -> Plan:
    """Return the plan of five cameras around a building: two pairs overlap, four have unseen
    paths.
    """
    places = {
        "street west": (-6.0, 12.0),
        "entrance": (5.0, 12.0),
        "hall": (10.8, 12.0),
        "corridor": (27.0, 12.0),
        "garden": (32.8, 12.0),
        "street east": (45.0, 12.0),
        "cafe": (14.0, -7.0),
        "street south": (3.0, -7.0),
        "kitchen door": (22.0, -7.0),
        "gate": (36.5, 21.5),
        "arbour": (1.0, 21.5),
    }
    ways = [
        ("street west", "entrance"),
        ("entrance", "hall"),
        ("hall", "corridor"),
        ("corridor", "garden"),
        ("garden", "street east"),
        ("hall", "cafe"),
        ("cafe", "street south"),
        ("cafe", "kitchen door"),
        ("kitchen door", "corridor"),
        ("garden", "gate"),
        ("gate", "arbour"),
        ("arbour", "entrance"),
    ]
    areas = [
        Area("stone", (-14, -15, 53, 30)),
        Area("grass", (-14, 16.5, 53, 30)),
        Area("grass", (29.7, 2.0, 53, 30)),
        Area("wood", (7.7, 2.0, 29.7, 15.5)),
        Area("brick", (4.5, -13, 17, 1.0)),
    ]
    south = -math.pi / 2
    north = math.pi / 2
    views = {"entrance": south, "hall": north, "corridor": north, "cafe": south, "garden": south}
    return Plan(
        places, ways, areas, [View(name, places[name], heading) for name, heading in views.items()]
    )


def simulate_walks(plan: Plan, seconds: float, rate: float, rng: np.random.Generator) -> list[Walk]:
    """Simulate people who come from the streets, ``rate`` per second, from `WARM_UP_SECONDS` before
    0.
    """
    starts = np.sort(
        rng.uniform(-WARM_UP_SECONDS, seconds, rng.poisson(rate * (seconds + WARM_UP_SECONDS)))
    )
    return [_walk(plan, float(start), seconds, rng) for start in starts]


def _walk(plan: Plan, start: float, end: float, rng: np.random.Generator) -> Walk:
    """Return one person's walk from ``start``, sampled at the frames up to ``end``."""
    line, way = _route(plan, rng)
    speed = WALKING_SPEED * math.exp(SPEED_SD * rng.standard_normal())

    # Cut the corners, over 1.5 metres.
    width = round(1.5 / STEP_METRES)
    long_line = np.pad(line, ((width, width), (0, 0)), mode="edge")
    smooth = np.column_stack(
        [np.convolve(column, np.full(width, 1 / width), "same") for column in long_line.T]
    )
    smooth = smooth[width:-width]

    # Keep to the right, more or less.
    ahead = np.gradient(smooth, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    lane = KEEP_RIGHT_METRES + LANE_SD_METRES * rng.standard_normal()
    smooth = smooth + lane * np.column_stack([ahead[:, 1], -ahead[:, 0]])

    # Sample positions at the frames.
    metres = STEP_METRES * np.arange(len(line))
    first = math.ceil(max(start, 0.0) * FPS)
    last = math.floor(min(start + metres[-1] / speed, end) * FPS)
    t = np.arange(first, max(first, last + 1)) / FPS
    distance = (t - start) * speed
    floor = np.column_stack([np.interp(distance, metres, column) for column in smooth.T])
    return Walk(t, floor, way[np.minimum((distance / STEP_METRES).astype(np.int64), len(way) - 1)])


def _route(plan: Plan, rng: np.random.Generator) -> tuple[Floats, Longs]:
    """Return a route from street to street: points every `STEP_METRES`, (n, 2), and their paths,
    (n,).
    """

    # Choose the next stop at random, without turning back, until a street is reached: a place with
    # a single path.
    streets = {name for name in plan.places if len(plan.around(name)) == 1}
    stops = [str(rng.choice(sorted(streets)))]
    while len(stops) < 2 or stops[-1] not in streets:
        onward = [name for name in plan.around(stops[-1]) if name not in stops[-2:-1]]
        street = 10.0 if len(stops) > 12 else 0.7  # after many stops people want to leave
        weight = np.array([street if name in streets else 1.0 for name in onward])
        stops.append(onward[int(rng.choice(len(onward), p=weight / weight.sum()))])

    # Sample the straight lines between the stops.
    points = []
    ways = []
    for a, b in pairwise(stops):
        begin = np.array(plan.places[a])
        end = np.array(plan.places[b])
        share = np.arange(0, 1, STEP_METRES / float(np.linalg.norm(end - begin)))[:, None]
        points.append(begin + share * (end - begin))
        number = next(k for k, way in enumerate(plan.ways) if {*way} == {a, b})
        ways.append(np.full(len(share), number))
    return np.concatenate(points), np.concatenate(ways)


def passages(plan: Plan, walks: list[Walk]) -> list[FloorPassage]:
    """Return all passages that begin and end within the recording, by walker and time."""
    result = []
    for walker, walk in enumerate(walks):
        for view in plan.views:
            is_seen = np.concatenate([[False], view.sees(walk.floor), [False]]).astype(np.int8)
            for begin, end in zip(
                np.flatnonzero(np.diff(is_seen) > 0),
                np.flatnonzero(np.diff(is_seen) < 0),
                strict=True,
            ):
                if begin == 0 or end == len(walk.t):
                    continue  # in view when the recording began or ended
                (xa, ya, _), (xb, yb, _) = np.clip(
                    view.feet(walk.floor[[begin, end - 1]]), 0.0, 1.0
                )
                result.append(
                    FloorPassage(
                        camera=view.camera,
                        walker=walker,
                        t_in=float(walk.t[begin]),
                        t_out=float(walk.t[end - 1]),
                        at_in=(float(xa), float(ya)),
                        at_out=(float(xb), float(yb)),
                        way_in=int(walk.way[begin]),
                        way_out=int(walk.way[end - 1]),
                    )
                )
    return sorted(result, key=lambda passage: (passage.walker, passage.t_in))


def truth_of(plan: Plan, walk_passages: list[FloorPassage]) -> Truth:
    """Return the ground truth of the recorded passages.

    Zones are where the edge of a picture cuts a path, links are transitions that were walked.
    """
    # Zones with their positions, numbered within their camera.
    points: dict[tuple[str, int], list[tuple[float, float]]] = defaultdict(list)
    for passage in walk_passages:
        points[passage.camera, passage.way_in].append(passage.at_in)
        points[passage.camera, passage.way_out].append(passage.at_out)
    cameras = [view.camera for view in plan.views]
    ids: dict[tuple[str, int], str] = {}
    for camera in cameras:
        places = sorted(place for place in points if place[0] == camera)
        ids |= {place: f"{camera}/{number}" for number, place in enumerate(places, 1)}
    zones = [zone_at(name, place[0], np.array(points[place])) for place, name in ids.items()]

    # Links with the transit times that were walked.
    lags: dict[tuple[str, str], list[float]] = defaultdict(list)
    for before, after in pairwise(walk_passages):
        if before.walker == after.walker:
            ends = ids[before.camera, before.way_out], ids[after.camera, after.way_in]
            lags[ends].append(after.t_in - before.t_out)
    exits = Counter(ids[passage.camera, passage.way_out] for passage in walk_passages)
    links = walked_links(lags, exits, {ends: len(seconds) for ends, seconds in lags.items()})
    pairs = pairs_of(links, {zone.id: zone.camera for zone in zones})
    return Truth(TRUTH_SCHEMA, cameras, zones, links, pairs)
