"""Tracking: blobs -> tracks -> entry and exit events of one view.

`tracker` is the centre and explains the method. It uses `track` (state of an object), `kalman`
(prediction of positions), `stature` (expected height of a person) and `assignment` (of blobs to
tracks). `crossings` turns track changes into events, with `doors`
for entrances away from the border and `ignored_areas` for objects that walk into one.
`decisions` has the reasons why a track became an event or not.
"""

from camtopod.vision.track.crossings import Crossings as Crossings, FrameView as FrameView
from camtopod.vision.track.decisions import Decision as Decision, Edge as Edge, Reason as Reason
from camtopod.vision.track.ignored_areas import IgnoredAreas as IgnoredAreas
from camtopod.vision.track.track import Track as Track
from camtopod.vision.track.tracker import Tracker as Tracker
