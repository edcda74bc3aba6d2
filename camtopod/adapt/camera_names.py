"""Camera ids from the names that other programs give to cameras."""

from __future__ import annotations

import unicodedata

from camtopod import codec
from camtopod.codec import Rejected

CAMERAS_MAX = 1000
"""Cameras (or analytics modules of cameras) followed; messages of further ones are refused."""


class CameraNames:
    """Gives each name an id of its own: ``Front Door`` is ``front_door``.

    only: id of the one camera, whatever its name; None if there may be several.
    """

    def __init__(self, only: str | None = None) -> None:
        self.new_names: dict[str, str] = {}
        """Ids that the user chose, by name."""
        self._only = only
        self._names: dict[str, tuple[str, str]] = {}
        """By id: where the camera's program is, and the camera's name there."""

    def id_of(self, name: str, channel: str = "", origin: str = "") -> str:
        """Return the id of a camera, with its channel behind it. Raises `Rejected`.

        origin: levels of the topic that tell one program from another; names of one differ.
        """
        if not name and self._only is None:
            raise Rejected("no-camera", "names no camera: give --camera ID")
        whole = f"{origin}/{name}" if origin else name
        chosen = self._only or self.new_names.get(whole) or self.new_names.get(name)
        camera = (chosen or folded(name)) + channel
        if not codec.is_camera(camera):
            raise Rejected(
                "no-camera",
                f"camera {name[:64]!r}: an id is 1 to 64 of the characters A-Z a-z 0-9 _ . -: "
                "give --rename NAME=ID",
            )
        if camera not in self._names and len(self._names) >= CAMERAS_MAX:
            raise Rejected("too-many-cameras", f"more than {CAMERAS_MAX} cameras")
        first_origin, first = self._names.setdefault(camera, (origin, name + channel))
        if first == name + channel and (first_origin == origin or not (first_origin and origin)):
            return camera
        if first == name + channel:
            first, name = f"{first_origin}/{first}", whole
        raise Rejected(
            "same-camera",
            f"cameras {first[:128]!r} and {name[:128]!r} would both be {camera}: "
            "give --rename NAME=ID, and no --camera",
        )


def folded(name: str) -> str:
    """Return a name that is no id in lower case, without accents, with ``_`` for blanks."""
    if codec.is_camera(name):
        return name
    letters = unicodedata.normalize("NFKD", name.casefold())
    return "_".join(
        "".join(letter for letter in letters if not unicodedata.combining(letter)).split()
    )
