"""Pictures of the cameras: files CAMERA.jpg or CAMERA.png in a folder that the operator fills."""

from __future__ import annotations

import re
from pathlib import Path

from camtopod.records import CAMERA_PATTERN

TYPES = {".jpg": "image/jpeg", ".png": "image/png"}


def picture_of(folder: Path | None, camera: str) -> Path | None:
    """The file of a camera's picture; None if there is none."""
    if folder is None or not re.match(CAMERA_PATTERN, camera):
        return None
    return next((path for ending in TYPES if (path := folder / f"{camera}{ending}").is_file()), None)
