"""Camera pictures: files CAMERA.jpg or CAMERA.png in a folder, of `check`, `init` or the operator.

They show the site and perhaps people. They are therefore never sent over the bus, and not readable
by every user of the machine.
"""

from __future__ import annotations

import os
from pathlib import Path

from camtopod import codec

TYPES = {".jpg": "image/jpeg", ".png": "image/png"}
"""Media type by file name extension."""


def picture_of(folder: Path | None, camera: str) -> Path | None:
    """Return the file of a camera's picture; None if there is none that this user may read."""
    if folder is None or not codec.is_camera(camera):
        return None
    paths = (folder / f"{camera}{ending}" for ending in TYPES)
    return next((path for path in paths if os.access(path, os.R_OK)), None)
