"""Computer vision: turns one camera's video into entry and exit events.

`grabber` is the entry point: it reads a `source`, passes frames through the `pipeline` and yields
events. Reading order:

- `settings`: all settings of a grabber, with units;
- `source`: files, streams and devices -> frames with capture times;
- `detect`: noise filter, background model, moving pixels -> blobs;
- `track`: blobs -> tracks -> crossings of the edge of the view;
- `pipeline`: frames -> events, without source, clock or waiting.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.vision.grabber import Grabber
    from camtopod.vision.settings import Polygon, VisionSettings

__all__ = [
    "Grabber",
    "Polygon",
    "VisionSettings",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "Grabber": "grabber",
        "Polygon": "settings",
        "VisionSettings": "settings",
    },
)
