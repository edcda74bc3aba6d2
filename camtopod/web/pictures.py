"""Camera pictures: files CAMERA.jpg or CAMERA.png in a folder, from `store_picture` or from the
operator.

They show the site and perhaps people. They are therefore never sent over the bus, and not readable
by every user of the machine.
"""

from __future__ import annotations

import os
from pathlib import Path

from camtopod import codec
from camtopod.config import secret_files

TYPES = {".jpg": "image/jpeg", ".png": "image/png"}
"""Media type by file name extension."""


def picture_of(folder: Path | None, camera: str) -> Path | None:
    """Return the file of a camera's picture; None if there is none that this user may read."""
    if folder is None or not codec.is_camera(camera):
        return None
    paths = (folder / f"{camera}{ending}" for ending in TYPES)
    return next((path for path in paths if os.access(path, os.R_OK)), None)


def store_picture(folder: Path, camera: str, jpeg: bytes) -> None:
    """Store a camera's picture, readable by the folder's owner and group.

    Replaces an earlier one. Raises `OSError`.
    """
    secret_files.write(folder / f"{camera}.jpg", jpeg, 0o640)
