"""Convert the output of other programs into entry and exit events. Pure: no I/O, clock or threads.

Read `adapter` first: the interface that all formats implement. `tracks.TrackEvents` turns the
tracks of any tracker into events; it is public, through `camtopod.client`. One module per format:
`frigate`, `mot`, `scenescape`. `box_linking` makes tracks of boxes without identity.
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
