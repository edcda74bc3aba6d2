"""Convert the output of other programs into entry and exit events. Pure: no I/O, clock or threads.

Read `adapter` first: the interface that all formats implement. `tracks.TrackEvents` turns the
tracks of any tracker into events; it is public, through `camtopod.client`. One module per format:
`frigate`, `mot`, `scenescape`, `axis`, `onvif`, `deepstream`; the last three share
`camera_streams`. `box_linking` makes tracks of boxes without identity, and `fragmentation` notices
a tracker that breaks tracks up.
"""

from __future__ import annotations

from camtopod.adapt.adapter import ANY_CAMERA, LINE_BYTES_MAX, Adapter, Size, quotable
from camtopod.adapt.axis import Axis
from camtopod.adapt.deepstream import DeepStream
from camtopod.adapt.fragmentation import Fragmentation
from camtopod.adapt.frigate import Frigate
from camtopod.adapt.mot import Mot
from camtopod.adapt.onvif import Onvif
from camtopod.adapt.scenescape import SceneScape
from camtopod.adapt.tracks import TrackEvents

__all__ = [
    "ANY_CAMERA",
    "LINE_BYTES_MAX",
    "Adapter",
    "Axis",
    "DeepStream",
    "Fragmentation",
    "Frigate",
    "Mot",
    "Onvif",
    "SceneScape",
    "Size",
    "TrackEvents",
    "quotable",
]
