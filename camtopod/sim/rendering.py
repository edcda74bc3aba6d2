"""Renderer of the demo: walks on the floor plan become the cameras' pictures and videos."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.sim.floor import FPS, HEIGHT, PERSON_METRES, WIDTH, Floor, Plan, View, Walk

Picture = NDArray[Any]
"""Picture (height, width, 3), BGR, 0 to 255."""
Colour = tuple[int, int, int]
"""Blue, green, red."""

PIXELS_PER_METRE = 24
"""Resolution of the floor's picture."""
MARGIN_METRES = 8.0
"""Margin of the floor's picture around the places of the plan."""
_FLOORS: dict[Floor, tuple[Colour, Colour, tuple[float, float]]] = {
    "stone": ((172, 178, 180), (150, 156, 158), (1.0, 1.0)),
    "grass": ((96, 150, 128), (88, 140, 118), (0.35, 0.6)),
    "wood": ((140, 172, 202), (118, 150, 180), (2.4, 0.4)),
    "brick": ((130, 150, 190), (112, 132, 172), (0.8, 0.4)),
}
"""Kind of floor -> colour, colour of the seams, and size of a slab in metres."""
NOISE_PICTURES = 8
"""Number of noise pictures that a video draws from."""
CODEC, SUFFIX = "mp4v", ".mp4"
"""Codec and file name suffix that encode and decode fastest at this size."""
_CLOTHES: tuple[Colour, ...] = (
    (60, 50, 40),
    (150, 70, 30),
    (40, 40, 150),
    (30, 90, 40),
    (110, 40, 110),
    (20, 120, 190),
    (90, 90, 20),
    (35, 30, 90),
    (120, 110, 30),
    (50, 20, 20),
)
_SKIN: tuple[Colour, ...] = ((150, 180, 220), (110, 140, 190), (60, 85, 130))


_Figure = tuple[float, tuple[float, float], tuple[float, float], float, int]
"""One person in one picture: depth, foot and head in pixels, swing of the legs in [-1, 1], walker.
"""


def on_plan(plan: Plan, places: Floats) -> Floats:
    """Return the pixels (..., 2) of places (..., 2), in metres, in the floor's picture."""
    west, _, _, north = _edges(plan)
    return (places - (west, north)) * (PIXELS_PER_METRE, -PIXELS_PER_METRE)


def _edges(plan: Plan) -> tuple[float, float, float, float]:
    """Return west, south, east and north ends of the floor's picture, metres."""
    at = np.array(list(plan.places.values()))
    west, south = at.min(0) - MARGIN_METRES
    east, north = at.max(0) + MARGIN_METRES
    return float(west), float(south), float(east), float(north)


def floor_picture(plan: Plan) -> Picture:
    """Return the floor from above, north up: slabs, stains and lighter paths."""
    west, south, east, north = _edges(plan)
    shape = round((north - south) * PIXELS_PER_METRE), round((east - west) * PIXELS_PER_METRE)
    picture: Picture = np.zeros((*shape, 3), dtype=np.uint8)

    def pixels(x: float, y: float) -> list[int]:
        result: list[int] = np.rint(on_plan(plan, np.array((x, y)))).astype(int).tolist()
        return result

    # Slabs with seams, every other row shifted by half a slab.
    for area in plan.areas:
        left, bottom, right, top = area.box
        colour, seam, (length, depth) = _FLOORS[area.floor]
        cv2.rectangle(picture, pixels(left, top), pixels(right, bottom), colour, -1)
        for row, y in enumerate(np.arange(bottom, top, depth)):
            cv2.line(picture, pixels(left, y), pixels(right, y), seam, 1)
            for x in np.arange(left + length * (1.0 - row % 2 / 2), right, length):
                cv2.line(picture, pixels(x, y), pixels(x, min(y + depth, top)), seam, 1)

    # Lighter paths, and stains.
    paths = picture.copy()
    for a, b in plan.ways:
        begin, end = (pixels(*plan.places[name]) for name in (a, b))
        cv2.line(paths, begin, end, (214, 220, 224), round(2.6 * PIXELS_PER_METRE), cv2.LINE_AA)
    blend = cv2.addWeighted(picture, 0.55, paths, 0.45, 0)
    coarse = np.random.default_rng(7).normal(0, 7, (shape[0] // 30 + 1, shape[1] // 30 + 1))
    stains = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)[..., None]
    return _grey_levels(blend + stains)


def _grey_levels(values: NDArray[Any]) -> Picture:
    """Return values clipped to 0 to 255."""
    result: Picture = np.clip(values, 0, 255).astype(np.uint8)
    return result


def scene(plan: Plan, view: View) -> Picture:
    """Return a camera's picture without people, (HEIGHT, WIDTH, 3) BGR."""
    # Warp the floor's picture to the view at twice the size, then shade and shrink it.
    size = 2 * WIDTH, 2 * HEIGHT
    corners = np.array(((0, 0), (1, 0), (1, 1), (0, 1)), np.float32) * np.array(size, np.float32)
    footprint = on_plan(plan, view.footprint()).astype(np.float32)
    homography = cv2.getPerspectiveTransform(footprint, corners)
    large = cv2.warpPerspective(
        floor_picture(plan), homography, size, borderMode=cv2.BORDER_REFLECT
    )
    shade = np.linspace(0.8, 1.05, 2 * HEIGHT)[:, None, None]
    return _grey_levels(cv2.resize(large * shade, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA))


def render(
    plan: Plan, view: View, walks: list[Walk], seconds: float, path: Path, seed: int
) -> None:
    """Write the camera's video from second 0 to ``seconds``. Raises OSError if it cannot be
    written.
    """

    # Prepare noisy pictures of the empty scene.
    frames = _figures(view, walks)
    empty = scene(plan, view)
    rng = np.random.default_rng(seed)
    noise = [
        np.clip(rng.normal(0, 2.5, empty.shape), -127, 127).astype(np.int8)
        for _ in range(NOISE_PICTURES)
    ]
    grain = [cv2.add(empty, part, dtype=cv2.CV_8U) for part in noise]
    cv2.imwrite(str(path.with_suffix(".png")), empty)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*CODEC), FPS, (WIDTH, HEIGHT))
    if not writer.isOpened():
        raise OSError(f"cannot write the video {path}")

    # Draw the people of each frame.
    for number, k in enumerate(rng.integers(0, NOISE_PICTURES, round(seconds * FPS))):
        picture = grain[k].copy()
        for figure in sorted(frames.get(number, []), reverse=True):
            _draw(picture, figure)
        writer.write(picture)
    writer.release()


def _figures(view: View, walks: list[Walk]) -> dict[int, list[_Figure]]:
    """Return the people of each frame that has any; people near its edge are included."""
    result: dict[int, list[_Figure]] = {}
    scale = np.array((WIDTH, HEIGHT))
    for walker, walk in enumerate(walks):
        feet = view.feet(walk.floor)
        heads = view.project(np.column_stack([walk.floor, np.full(len(walk.t), PERSON_METRES)]))
        near = (feet[:, 2] > 0.5) & (np.abs(feet[:, :2] - 0.5) < 0.8).all(1)
        steps = np.linalg.norm(np.diff(walk.floor, axis=0, prepend=walk.floor[:1]), axis=1)
        swing = np.sin(2 * np.pi * np.cumsum(steps) / (2 * 0.75))  # steps of 0.75 m
        for i in np.flatnonzero(near):
            foot_x, foot_y = (feet[i, :2] * scale).tolist()
            head_x, head_y = (heads[i, :2] * scale).tolist()
            figure = (float(feet[i, 2]), (foot_x, foot_y), (head_x, head_y), swing[i], walker)
            result.setdefault(round(float(walk.t[i]) * FPS), []).append(figure)
    return result


def _draw(picture: Picture, figure: _Figure) -> None:
    """Draw a person (shadow, legs, body with arms, head) in proportion to the height in the
    picture.
    """
    _, (fx, fy), (hx, hy), swing, walker = figure
    tall = max(1.0, fy - hy)
    bits = 4  # of the fractions in coordinates
    coat = _CLOTHES[walker % 10]
    trousers = _CLOTHES[(walker * 7 + 3) % 10]

    def at(across: float, up: float) -> tuple[int, int]:
        x, y = fx + across * tall + (hx - fx) * up, fy + (hy - fy) * up
        return round(x * (1 << bits)), round(y * (1 << bits))

    axes = round(0.16 * tall * (1 << bits)), round(0.06 * tall * (1 << bits))
    cv2.ellipse(picture, at(0, 0), axes, 0, 0, 360, (120, 126, 130), -1, cv2.LINE_AA, bits)
    reach = 0.13 * swing
    limbs = (
        ((0.05, 0.48), (0.05 + reach, 0.02), 0.11, trousers),
        ((-0.05, 0.48), (-0.05 - reach, 0.02), 0.11, trousers),
        ((0, 0.5), (0, 0.74), 0.26, coat),
        ((0.13, 0.74), (0.13 - reach, 0.5), 0.08, coat),
        ((-0.13, 0.74), (-0.13 + reach, 0.5), 0.08, coat),
    )
    for begin, end, width, colour in limbs:
        thick = max(1, round(width * tall))
        cv2.line(picture, at(*begin), at(*end), colour, thick, cv2.LINE_AA, bits)
    radius = round(0.085 * tall * (1 << bits))
    cv2.circle(picture, at(0, 0.92), radius, _SKIN[walker % 3], -1, cv2.LINE_AA, bits)
