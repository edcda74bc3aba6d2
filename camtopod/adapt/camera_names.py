"""Camera ids from the names that other programs give to cameras."""

from __future__ import annotations

import re
import unicodedata

from camtopod.codec import Rejected
from camtopod.records import CAMERA_PATTERN

CAMERAS_MAX = 1000
"""Cameras followed; messages of further ones are refused."""


class CameraNames:
    """Gives each name an id of its own: ``Front Door`` is ``front_door``."""

    def __init__(self) -> None:
        self.renamed: dict[str, str] = {}
        """Ids that the user chose, by name."""
        self._ids: dict[str, str] = {}
        self._names: dict[str, str] = {}

    def id_of(self, name: str) -> str:
        """Return a camera's id. Raises `Rejected`, also if another name has it already."""
        if name in self._ids:
            return self._ids[name]
        if not name:
            raise Rejected("no-camera", "names no camera: give --camera ID")
        camera = self.renamed.get(name) or _folded(name)
        called = repr(name[:64])
        if not re.match(CAMERA_PATTERN, camera):
            raise Rejected(
                "no-camera",
                f"camera {called}: an id is 1 to 64 of the characters A-Z a-z 0-9 _ . -: "
                "give --rename NAME=ID",
            )
        if camera in self._names:
            raise Rejected(
                "same-camera",
                f"cameras {self._names[camera][:64]!r} and {called} would both be {camera}: "
                "give --rename NAME=ID",
            )
        if len(self._ids) >= CAMERAS_MAX:
            raise Rejected("too-many-cameras", f"more than {CAMERAS_MAX} cameras")
        self._ids[name] = camera
        self._names[camera] = name
        return camera


def _folded(name: str) -> str:
    """Return a name that is no id in lower case, without accents, with ``_`` for blanks."""
    if re.match(CAMERA_PATTERN, name):
        return name
    letters = unicodedata.normalize("NFKD", name.casefold())
    return "_".join("".join(one for one in letters if not unicodedata.combining(one)).split())
