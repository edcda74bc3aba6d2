"""Pictures of the cameras: files CAMERA.jpg or CAMERA.png in a folder, from `keep` or the
operator's own.

They are of the site and perhaps of people: never sent over the bus, and not for everybody on the
machine.
"""

from __future__ import annotations

import re
from pathlib import Path

from camtopod.config import secret_files
from camtopod.records import CAMERA_PATTERN

TYPES = {".jpg": "image/jpeg", ".png": "image/png"}
_FOLDER_MODE, _FILE_MODE = 0o750, 0o640


def picture_of(folder: Path | None, camera: str) -> Path | None:
    """The file of a camera's picture; None if there is none."""
    if folder is None or not re.match(CAMERA_PATTERN, camera):
        return None
    return next(
        (path for ending in TYPES if (path := folder / f"{camera}{ending}").is_file()), None
    )


def kept_at(folder: Path, camera: str) -> Path:
    """Where `keep` puts a camera's picture."""
    return folder / f"{camera}.jpg"


def make(folder: Path) -> None:
    """The folder, if it is not there. Raises `OSError`."""
    folder.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)


def keep(folder: Path, camera: str, jpeg: bytes) -> None:
    """Put a camera's picture there instead of the one before, for the folder's owner and group.
    Raises `OSError`.
    """
    secret_files.write(kept_at(folder, camera), jpeg, _FILE_MODE)
