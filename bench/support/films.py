"""Rendered films of a fixed camera: people on a textured floor, with sensor noise, as H.264.

Needs the ``ffmpeg`` program with libx264.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

FPS = 25
"""Frames a second."""
KEY_FRAME_EVERY = 50
"""Frames from one key frame to the next."""
NOISE_SD = 1.5
"""Standard deviation of the sensor's noise, grey levels, in each colour."""
NOISE_PICTURES = 16
"""Noise pictures that are rendered and then drawn from."""
CROSSING_SECONDS = 9.0
"""Time in which a walker crosses the picture, seconds."""
STRIDE_HEIGHTS = 0.45
"""Length of a stride, in heights of the walker."""
CRF = 20
"""Quality setting of x264.

With it a busy film has about the bit rate that cameras are set to (1080p: 2 to 4 Mbit/s).
"""
ENCODER = ("-c:v", "libx264", "-preset", "veryfast", "-profile:v", "main", "-bf", "0")
"""ffmpeg options of the encoder."""
_SUBPIXEL = 4
"""Fractional bits of drawing coordinates."""


class Walker(NamedTuple):
    """A person who crosses the picture from one side to the other, again and again."""

    foot_row: float
    """Row of the feet, fraction of the picture's height."""
    tall: float
    """Height of the person, fraction of the picture's height."""
    starts: float
    """Start of the first crossing, seconds."""
    pause: float
    """Seconds from leaving the picture until entering it again."""
    rightwards: bool
    clothes: tuple[int, ...]
    """Colours of coat and trousers, one after the other."""


def people(count: int, pause: float, seed: int) -> list[Walker]:
    """Return ``many`` walkers; those further down in the picture are taller, as if nearer."""
    rng = np.random.default_rng(seed)
    result = []
    for number in range(count):
        row = float(rng.uniform(0.45, 0.95))
        starts = 4.0 + (number + float(rng.uniform())) * (CROSSING_SECONDS + pause) / count
        clothes = tuple(int(value) for value in rng.integers(10, 240, 6))
        result.append(Walker(row, 0.08 + 0.28 * row, starts, pause, bool(rng.integers(2)), clothes))
    return sorted(result)


def floor(width: int, height: int, seed: int) -> Picture:
    """Return an empty scene (H, W, 3): slabs with seams under patches of all sizes."""
    rng = np.random.default_rng(seed)
    picture = np.full((height, width, 3), (128, 138, 144), dtype=np.float32)
    for cell, contrast in (
        (height // 3, 22.0),
        (height // 12, 12.0),
        (height // 60, 7.0),
        (2, 5.0),
    ):
        coarse = rng.normal(0, contrast, (height // cell + 2, width // cell + 2)).astype(np.float32)
        picture += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)[..., None]
    for row in range(0, height, height // 9):
        cv2.line(
            picture,
            (0, row),
            (width, row + height // 40),
            (95, 100, 104),
            max(1, height // 360),
            cv2.LINE_AA,
        )
    result: Picture = np.clip(picture, 20, 235).astype(np.uint8)
    return result


def film(
    path: Path,
    size: tuple[int, int],
    walkers: list[Walker],
    seconds: float,
    crf: int = CRF,
    seed: int = 1,
) -> Path:
    """Write an H.264 film of ``size`` (width, height) at `FPS` and return its path.

    Raises OSError if ffmpeg fails.
    """
    width, height = size
    empty = floor(width, height, seed)
    rng = np.random.default_rng(seed)
    noise = [
        rng.normal(0, NOISE_SD, empty.shape).round().astype(np.int8) for _ in range(NOISE_PICTURES)
    ]

    # Options of ffmpeg.
    raw = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "bgr24",
        "-s",
        f"{width}x{height}",
        "-r",
        str(FPS),
        "-i",
        "pipe:0",
    ]
    encode = [
        *ENCODER,
        "-crf",
        str(crf),
        "-g",
        str(KEY_FRAME_EVERY),
        "-pix_fmt",
        "yuv420p",
        str(path),
    ]
    command = ["ffmpeg", "-loglevel", "error", "-y", *raw, *encode]

    # Draw and encode.
    with subprocess.Popen(command, stdin=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        for frame in range(round(seconds * FPS)):
            picture = empty.copy()
            for walker in walkers:
                draw(picture, walker, frame / FPS)
            image = cv2.add(picture, noise[int(rng.integers(NOISE_PICTURES))], dtype=cv2.CV_8U)
            encoder.stdin.write(np.ascontiguousarray(image).tobytes())
    if encoder.returncode:
        raise OSError(f"ffmpeg cannot write {path}")
    return path


def draw(picture: NDArray[Any], walker: Walker, t: float) -> None:
    """Draw the walker at ``t`` seconds, if in the picture."""
    share = (t - walker.starts) % (CROSSING_SECONDS + walker.pause) / CROSSING_SECONDS
    if t < walker.starts or share > 1.0:
        return

    # Position and step.
    height, width = picture.shape[:2]
    tall = walker.tall * height
    margin = 0.2 * tall
    x = -margin + (share if walker.rightwards else 1.0 - share) * (width + 2 * margin)
    y = walker.foot_row * height
    swing = 0.12 * np.sin(2 * np.pi * share * width / (2 * STRIDE_HEIGHTS * tall))
    draw_person(picture, x, y, tall, swing, walker.clothes)


def draw_person(
    picture: NDArray[Any], x: float, y: float, tall: float, swing: float, clothes: tuple[int, ...]
) -> None:
    """Draw a person.

    x, y (pixels): foot point.
    tall (pixels): height.
    swing: how far arms and legs swing, heights.
    clothes: colours of coat and trousers, one after the other.
    """
    coat, trousers = clothes[:3], clothes[3:]

    def at(across: float, up: float) -> tuple[int, int]:
        return round((x + across * tall) * (1 << _SUBPIXEL)), round(
            (y - up * tall) * (1 << _SUBPIXEL)
        )

    def limb(
        a: tuple[float, float], b: tuple[float, float], wide: float, colour: tuple[int, ...]
    ) -> None:
        cv2.line(
            picture, at(*a), at(*b), colour, max(1, round(wide * tall)), cv2.LINE_AA, _SUBPIXEL
        )

    for side in (-1, 1):
        limb((0.04 * side, 0.48), (0.04 * side + side * swing, 0.03), 0.1, trousers)
        limb((0.12 * side, 0.76), (0.12 * side - side * swing, 0.48), 0.07, coat)
    limb((0.0, 0.5), (0.0, 0.74), 0.22, coat)
    limb((0.0, 0.62), (0.0, 0.65), 0.1, trousers)  # a bag
    cv2.circle(
        picture,
        at(0.0, 0.92),
        round(0.075 * tall * (1 << _SUBPIXEL)),
        (120, 150, 190),
        -1,
        cv2.LINE_AA,
        _SUBPIXEL,
    )
