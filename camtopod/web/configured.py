"""Settings of the page: floor plan, camera positions, and addresses of recorders."""

from __future__ import annotations

from pathlib import Path

from msgspec import Struct

from camtopod.config import Config
from camtopod.export import Place


class Configured(Struct, frozen=True):
    """Settings of the page; the default is a page without any.

    pages: camera -> address of its page at the recorder.
    plan: picture of the floor plan beneath the map.
    at: camera -> place on the plan, in fractions of its width and height.
    """

    pages: dict[str, str] = {}
    plan: Path | None = None
    at: dict[str, Place] = {}

    @classmethod
    def of(cls, config: Config) -> Configured:
        """Return the settings of a configuration."""
        cameras = config.cameras.items()
        pages = {name: camera.page for name, camera in cameras if camera.page}
        if not config.map.plan:
            return cls(pages)
        at = {name: (camera.at[0], camera.at[1]) for name, camera in cameras if camera.at}
        return cls(pages, Path(config.map.plan), at)
