"""Convert the output of other programs into entry and exit events. Pure: no I/O, clock or threads.

Read `formats` first, the table of all formats, and `adapter`, the interface that they implement;
`framing` splits the input into messages.
`tracks.TrackEvents` turns the tracks of any tracker into events; it is public, through
`camtopod.client`. `mot` is the shortest format, then `frigate`; `axis`, `onvif`, `deepstream` and
`scenescape` (with `box_linking`) share `camera_streams`. `boxes` finds foot points, `kinds` decides
what counts, `camera_names` gives cameras their ids, and `object_tree` follows ids that ONVIF
explains.
"""

from camtopod.adapt.adapter import (
    ANY_CAMERA as ANY_CAMERA,
    LINE_BYTES_MAX as LINE_BYTES_MAX,
    Adapter as Adapter,
    Size as Size,
)
from camtopod.adapt.camera_names import folded as folded
from camtopod.adapt.formats import FORMATS as FORMATS
from camtopod.adapt.framing import frames as frames
from camtopod.adapt.tracks import TrackEvents as TrackEvents
