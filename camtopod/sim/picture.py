"""Picture of the demo: the true and the learned map, and the learned zones in each camera's
view.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.records import Link, Topology
from camtopod.sim.floor import HEIGHT, WIDTH, Plan, Walk
from camtopod.sim.rendering import (
    PIXELS_PER_METRE,
    Colour,
    Picture,
    busy_scene,
    floor_picture,
    plan_corner,
)
from camtopod.sim.scoring import match_zones
from camtopod.sim.truth import TrueLink, Truth

MAP_WIDTH, MAP_HEIGHT = 776, 560
"""Size of each map, pixels."""
THUMB_WIDTH, THUMBS_PER_ROW = 300, 5
"""Width of a camera's picture (pixels), and how many stand in a row."""
FRAME = 16
"""Margin around a camera's picture, pixels, so that zones at its border are fully visible."""
GAP = 16
"""Space between the parts, pixels."""
HEADER, TITLE, LINE = 58, 34, 22
"""Heights of the header, of a title and of a line of notes, pixels."""
INK: Colour = (40, 40, 40)
PAPER: Colour = (250, 250, 250)
BLACK: Colour = (20, 20, 20)
GREY: Colour = (150, 150, 150)
NODE: Colour = (190, 120, 40)
FOUND: Colour = (70, 160, 60)
FALSE: Colour = (40, 60, 210)
FONT = cv2.FONT_HERSHEY_DUPLEX
ZONES_LEGEND = (
    "ellipses: learned zones, two standard deviations; green: a true zone; diamonds: true centres"
)
LEGEND = "black: views overlap   grey: unseen path   seconds left to right / right to left"
Point = tuple[float, float]
"""Position in pixels."""
Times = dict[tuple[str, str], tuple[bool, float]]
"""(from camera, to camera) -> (True if the views overlap, mode of the transit times in seconds)."""


def write_map(
    path: Path,
    plan: Plan,
    walks: list[Walk],
    truth: Truth,
    topology: Topology,
    notes: Sequence[str],
) -> None:
    """Write the picture as PNG; ``notes`` are lines of text below it. Raises OSError."""

    # An empty sheet.
    rows = -(-len(plan.views) // THUMBS_PER_ROW)
    thumb_height = THUMB_WIDTH * HEIGHT // WIDTH
    width = 2 * MAP_WIDTH + 3 * GAP
    height = HEADER + MAP_HEIGHT + GAP + rows * (TITLE + thumb_height) + LINE * (len(notes) + 2)
    sheet: Picture = np.full((height, width, 3), PAPER, dtype=np.uint8)

    # The two maps.
    camera = {zone.id: zone.camera for zone in truth.zones}
    true_times = camera_times(truth.links, camera)
    camera = {zone.id: zone.camera for zone in topology.zones}
    learned_times = camera_times(topology.links, camera)
    for k, (title, times) in enumerate((("true", true_times), ("learned", learned_times))):
        left = GAP + k * (MAP_WIDTH + GAP)
        ground = _ground(plan, faded=0.3 if k == 0 else 0.75)
        _network(ground, _places(plan), times, true_times)
        cv2.rectangle(ground, (0, 0), (MAP_WIDTH - 1, MAP_HEIGHT - 1), GREY, 1)
        sheet[HEADER : HEADER + MAP_HEIGHT, left : left + MAP_WIDTH] = ground
        _text(sheet, f"{title} map", (left + 2, HEADER - 16), 0.75)
        _text(sheet, LEGEND, (left + 180, HEADER - 16), 0.42)

    # The cameras' pictures with learned zones.
    matched = set(match_zones(topology.zones, truth.zones).values())
    top = HEADER + MAP_HEIGHT + GAP + TITLE
    for k, view in enumerate(plan.views):
        left = GAP + (k % THUMBS_PER_ROW) * (THUMB_WIDTH + GAP)
        y = top + (k // THUMBS_PER_ROW) * (thumb_height + TITLE)
        view_size = THUMB_WIDTH - 2 * FRAME, thumb_height - 2 * FRAME
        seen = cv2.resize(busy_scene(plan, view, walks), view_size, interpolation=cv2.INTER_CUBIC)
        thumb = cv2.copyMakeBorder(
            seen, FRAME, FRAME, FRAME, FRAME, cv2.BORDER_CONSTANT, value=PAPER
        )
        _zones(thumb, view.camera, topology, truth, matched)
        sheet[y : y + thumb_height, left : left + THUMB_WIDTH] = thumb
        _text(sheet, f"{view.camera}: learned zones", (left + FRAME, y + 4), 0.48)

    # Legend and notes.
    bottom = height - LINE * (len(notes) + 1)
    for k, note in enumerate([ZONES_LEGEND, *notes]):
        _text(sheet, note, (GAP + 2, bottom + k * LINE), 0.5)
    if not cv2.imwrite(str(path), sheet):
        raise OSError(f"cannot write the picture {path}")


def camera_times(links: Sequence[Link] | Sequence[TrueLink], camera: dict[str, str]) -> Times:
    """Return, for each direction between two cameras, relation and mode of the link walked most."""
    best: dict[tuple[str, str], tuple[bool, float, float]] = {}
    for link in links:
        key = camera[link.from_], camera[link.to]
        value = link.relation == "overlapped", float(link.transitions), link.transit.mode
        if link.relation != "visible" and key[0] != key[1]:
            best[key] = max(best.get(key, value), value)
    return {key: (overlapped, mode) for key, (overlapped, _, mode) in best.items()}


def _window(plan: Plan) -> tuple[float, float, float]:
    """Return the part of the plan on the map: west and north end in metres, pixels per metre."""
    seen = np.concatenate([view.footprint() for view in plan.views])
    low = seen.min(0) - 3.0
    high = seen.max(0) + 3.0
    scale = float(min(MAP_WIDTH / (high[0] - low[0]), MAP_HEIGHT / (high[1] - low[1])))
    middle = (low + high) / 2
    return (
        float(middle[0]) - MAP_WIDTH / 2 / scale,
        float(middle[1]) + MAP_HEIGHT / 2 / scale,
        scale,
    )


def _places(plan: Plan) -> dict[str, Point]:
    """Return the position of each camera's view on the map, pixels."""
    west, north, scale = _window(plan)
    return {
        v.camera: ((v.target[0] - west) * scale, (north - v.target[1]) * scale) for v in plan.views
    }


def _ground(plan: Plan, faded: float) -> Picture:
    """Return the background of a map: the floor plan and the cameras' footprints."""
    west, north, scale = _window(plan)
    edge_west, _, _, edge_north = plan_corner(plan)
    zoom = scale / PIXELS_PER_METRE
    shift = np.array(
        [[zoom, 0, (edge_west - west) * scale], [0, zoom, (north - edge_north) * scale]]
    )

    # The floor at the scale of the map.
    smooth = cv2.GaussianBlur(floor_picture(plan), (3, 3), 0)
    floor = cv2.warpAffine(smooth, shift, (MAP_WIDTH, MAP_HEIGHT), borderMode=cv2.BORDER_REPLICATE)

    # Footprints.
    seen = floor.copy()
    outlines = []
    for view in plan.views:
        outlines.append(
            np.round((view.footprint() - (west, north)) * (scale, -scale)).astype(np.int32)
        )
        cv2.fillPoly(seen, [outlines[-1]], (255, 240, 215))
    floor = cv2.addWeighted(floor, 0.5, seen, 0.5, 0)
    for outline in outlines:
        cv2.polylines(floor, [outline], True, NODE, 2, cv2.LINE_AA)
    result: Picture = cv2.addWeighted(floor, 1 - faded, np.full_like(floor, 255), faded, 0).astype(
        np.uint8
    )
    return result


def _network(picture: Picture, place: dict[str, Point], times: Times, true_times: Times) -> None:
    """Draw links, then cameras and labels; a pair that is not related in truth has a red label."""
    labels = []
    for pair in sorted({(min(key), max(key)) for key in times}):
        a, b = sorted(pair, key=lambda name: place[name])
        ways = [times.get((a, b)), times.get((b, a))]
        overlapped = any(way[0] for way in ways if way)
        line = _curve(place[a], place[b], [at for name, at in place.items() if name not in (a, b)])
        dots = [np.round(line * 16).astype(np.int32)]
        cv2.polylines(picture, dots, False, PAPER, 9, cv2.LINE_AA, 4)
        cv2.polylines(picture, dots, False, BLACK if overlapped else GREY, 5, cv2.LINE_AA, 4)
        text = " / ".join("-" if way is None else f"{way[1]:.1f}" for way in ways)
        wrong = (a, b) not in true_times and (b, a) not in true_times
        lift = 10 if place[b][0] - place[a][0] > 120 else 20  # above near cameras
        labels.append((line[len(line) // 2] - (0, lift), text, FALSE if wrong else INK))
    for name, (x, y) in place.items():
        cv2.circle(picture, (round(x), round(y)), 13, PAPER, -1, cv2.LINE_AA)
        cv2.circle(picture, (round(x), round(y)), 11, NODE, -1, cv2.LINE_AA)
        _text(picture, name, (x, y + 32), 0.5, centred=True, halo=True)
    for (x, y), text, colour in labels:
        _text(picture, text, (float(x), float(y)), 0.45, colour, centred=True, halo=True)


def _curve(a: Point, b: Point, others: list[Point]) -> Floats:
    """Return a line from a to b, (n, 2), bent if it would run through another camera."""
    start = np.array(a)
    end = np.array(b)
    along = end - start
    length = float(np.linalg.norm(along))
    normal = np.array((along[1], -along[0])) / length
    bend = 0.0
    for other in others:
        share = float((np.array(other) - start) @ along) / length**2
        if 0.02 < share < 0.98 and abs(float((np.array(other) - start) @ normal)) < 40:
            bend = 0.4 * length
    middle = (start + end) / 2 + bend * normal
    s = np.linspace(0, 1, 41)[:, None]
    result: Floats = (1 - s) ** 2 * start + 2 * s * (1 - s) * middle + s**2 * end
    return result


def _zones(
    picture: NDArray[Any], camera: str, topology: Topology, truth: Truth, matched: set[str]
) -> None:
    """Draw learned zones as ellipses (two standard deviations), green if true; true centres as
    diamonds.
    """
    height, width = picture.shape[0] - 2 * FRAME, picture.shape[1] - 2 * FRAME
    for true in truth.zones:
        if true.camera == camera and true.x is not None and true.y is not None:
            at = FRAME + round(true.x * width), FRAME + round(true.y * height)
            cv2.drawMarker(picture, at, INK, cv2.MARKER_DIAMOND, 9, 1, cv2.LINE_AA)
    for zone in topology.zones:
        if zone.camera != camera or zone.x is None or zone.y is None or zone.cov is None:
            continue
        scale = np.diag((width, height))
        values, axes = np.linalg.eigh(scale @ np.array(zone.cov) @ scale)
        radii = np.maximum(2 * np.sqrt(np.maximum(values, 0)), 6)
        angle = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
        centre = FRAME + zone.x * width, FRAME + zone.y * height
        colour = FOUND if zone.id in matched else FALSE
        cv2.ellipse(picture, (centre, (2 * radii[1], 2 * radii[0]), angle), colour, 2, cv2.LINE_AA)
        inwards = np.array((FRAME + width / 2, FRAME + height / 2)) - centre
        x, y = centre + inwards / max(float(np.linalg.norm(inwards)), 1.0) * 24
        number = zone.id.rpartition("/")[2]
        _text(picture, number, (float(x), float(y) + 6), 0.55, colour, centred=True, halo=True)


def _text(
    picture: NDArray[Any],
    text: str,
    at: Point,
    size: float,
    colour: Colour = INK,
    centred: bool = False,
    halo: bool = False,
) -> None:
    """Write ``text``; ``at`` is its left end, or its middle if ``centred``."""
    (width, _), _ = cv2.getTextSize(text, FONT, size, 1)
    origin = round(at[0] - (width / 2 if centred else 0)), round(at[1])
    for dx, dy in (
        ((-2, 0), (2, 0), (0, -2), (0, 2), (-1, -1), (1, 1), (-1, 1), (1, -1)) if halo else ()
    ):
        cv2.putText(
            picture, text, (origin[0] + dx, origin[1] + dy), FONT, size, PAPER, 1, cv2.LINE_AA
        )
    cv2.putText(picture, text, origin, FONT, size, colour, 1, cv2.LINE_AA)
