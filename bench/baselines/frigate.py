"""Frigate's processing of a camera before any detector, rewritten from its sources.

Frigate 0.16, MIT licence. An ``ffmpeg`` process decodes, takes ``fps`` frames a second, scales them
to the detect size and pipes them as raw yuv420p; they are read into a buffer. Motion is detected on
the luma at 100 rows: contrast stretched between the 4th and 96th percentile averaged over 50
frames, blurred, compared with a running mean, thresholded, dilated, contours. Default settings: 5
frames a second, threshold 30, contours from 10 pixels, learning rate 0.01 (0.2 at first), two
threads. Left out, in Frigate's favour: the transfer of frames between processes through shared
memory and two queues.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

FPS = 5
ROWS = 100
THRESHOLD = 30
CONTOUR_AREA_MIN = 10.0
LEARNING_RATE, FIRST_LEARNING_RATE = 0.01, 0.2
CONTRAST_FRAMES = 50
CALIBRATED_SHARE, CALIBRATED_BOXES = 0.05, 4
LIGHTNING_SHARE = 0.8
STUBBORN_FRAMES = 10
"""Frames of uninterrupted motion after which the running mean follows it all the same."""

Box = tuple[int, int, int, int]


class Motion:
    """Motion detection against a running mean."""

    def __init__(self, width: int, height: int) -> None:
        self._size = (ROWS * width // height, ROWS)
        self._factor = height / ROWS
        self._mean = np.zeros((ROWS, self._size[0]), np.float32)
        self._contrast = np.tile(np.array([0, 255], np.uint8), (CONTRAST_FRAMES, 1))
        self._frames = 0
        self._moving_frames = 0
        self._calibrating = True

    def detect(self, luma: NDArray[np.uint8]) -> list[Box]:
        """Return the boxes (left, top, right, bottom) that move, in pixels of ``luma`` (H, W)."""
        # Mask of the pixels that differ from the running mean.
        small = cv2.resize(luma, self._size, interpolation=cv2.INTER_NEAREST)
        blurred = gaussian_filter(self._stretched(small), sigma=1, radius=1)
        difference = cv2.absdiff(blurred, cv2.convertScaleAbs(self._mean))
        mask = cv2.threshold(difference, THRESHOLD, 255, cv2.THRESH_BINARY)[1]
        mask = cv2.dilate(mask, np.ones((3, 3), np.uint8), iterations=1)

        # Boxes of the contours.
        boxes, moving_area = [], 0.0
        for contour in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]:
            area = cv2.contourArea(contour)
            moving_area += area
            if area > CONTOUR_AREA_MIN:
                x, y, width, height = cv2.boundingRect(contour)
                left, top, right, bottom = (
                    int(self._factor * value) for value in (x, y, x + width, y + height)
                )
                boxes.append((left, top, right, bottom))

        # Calibration: fast learning at the start and after a change of light.
        share = moving_area / mask.size
        if share < CALIBRATED_SHARE and len(boxes) <= CALIBRATED_BOXES:
            self._calibrating = False
        if share > LIGHTNING_SHARE:
            self._calibrating = True

        # Update the running mean.
        self._moving_frames = self._moving_frames + 1 if boxes else 0
        if not boxes or self._moving_frames >= STUBBORN_FRAMES:
            rate = FIRST_LEARNING_RATE if self._calibrating else LEARNING_RATE
            cv2.accumulateWeighted(blurred, self._mean, rate)
        return boxes

    def _stretched(self, small: NDArray[Any]) -> NDArray[np.uint8]:
        dark, bright = (int(np.percentile(small, share)) for share in (4, 96))
        if dark >= bright:
            return small
        self._contrast[self._frames % CONTRAST_FRAMES] = (dark, bright)
        self._frames += 1
        low, high = np.mean(self._contrast, axis=0)
        result: NDArray[np.uint8] = ((np.clip(small, low, high) - low) / (high - low) * 255).astype(
            np.uint8
        )
        return result


def watch(path: Path, width: int, height: int, fps: float = FPS) -> tuple[int, int]:
    """Return the number of frames, and of frames with motion, at detect size (width, height)."""
    command = [
        "ffmpeg",
        "-nostdin",
        "-hide_banner",
        "-loglevel",
        "warning",
        "-threads",
        "2",
        "-i",
        str(path),
    ]
    command += ["-r", str(fps), "-vf", f"fps={fps},scale={width}:{height}"]
    command += ["-threads", "2", "-f", "rawvideo", "-pix_fmt", "yuv420p", "pipe:"]
    size = width * height * 3 // 2
    buffer = np.empty(size, np.uint8)
    luma = buffer[: width * height].reshape(height, width)
    motion = Motion(width, height)
    frames = moving_frames = 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=size * 10) as decoder:
        assert decoder.stdout is not None
        while len(data := decoder.stdout.read(size)) == size:
            buffer[:] = np.frombuffer(data, np.uint8)
            frames += 1
            moving_frames += bool(motion.detect(luma))
    if decoder.returncode:
        raise OSError(f"ffmpeg cannot decode {path}")
    return frames, moving_frames
