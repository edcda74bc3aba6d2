"""Other programs' output -> entry and exit events. One module a format; no I/O, no clock, no
threads.

`tracks.TrackEvents` is what they share: tracks, frame by frame, in; events out.
"""

from __future__ import annotations

from camtopod.adapt.adapter import ANY_CAMERA, LINE_BYTES_MAX, Adapter, Size, quotable
from camtopod.adapt.frigate import Frigate
from camtopod.adapt.mot import Mot
from camtopod.adapt.scenescape import SceneScape
from camtopod.adapt.tracks import TrackEvents

__all__ = [
    "ANY_CAMERA",
    "LINE_BYTES_MAX",
    "Adapter",
    "Frigate",
    "Mot",
    "SceneScape",
    "Size",
    "TrackEvents",
    "quotable",
]
