"""Records of the decisions about a track, which explain its events and missing events.

`Tracker` and `Crossings` make them where they decide.
The command line puts them into words.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

Edge = Literal[
    "left border",
    "right border",
    "top border",
    "bottom border",
    "ignored area",
    "named door",
    "learned door",
    "mid-view",
]
"""Where objects enter and leave the view. An ignored area is one if it reaches to the border;
mid-view is one where a detector is trusted."""

Shortfall = Literal["brief", "patchy", "still", "fragment", "low"]
"""What a tentative track lacks to be an object; `Decision.value` is compared with `least`.

brief: followed for `value` seconds.
patchy: seen in the share `value` of the frames.
still: moved by `value` heights.
fragment: `value` pixels high, where a person is higher.
low: as tall as the setting `min_height` in `value` sightings.
"""

Beginning = Literal["entered", "from start", "beside others", "in mid-view"]
"""What the beginning of an object was taken for.

entered: an entry, by `edge`.
from start: in view when watching began, so no entry.
beside others: began next to another object, so rather half of a group than a new one.
in mid-view: began away from every edge; if that happens again and again, a door is learned.
"""

Ending = Literal[
    "left", "lost", "occluded", "interrupted", "ghost", "scene changed", "blind", "in view"
]
"""Why a track has ended.

left: an exit, by `edge`.
lost: out of sight in mid-view; if that happens again and again at a place, a door is learned.
occluded: the same, but last seen occluded by others, which says nothing of a door.
interrupted: in mid-view when the frames paused.
ghost: not an object, but the hole that one has left in the background model.
scene changed: the whole image has changed, and all tracks are forgotten.
blind: nothing could be told from the pictures any more.
in view: still there at the end of the recording.
"""

Reason = Beginning | Shortfall | Ending


class Decision(NamedTuple):
    """What the beginning or the end of a track was taken for, and why."""

    reason: Reason
    track: int
    t: float
    """Capture time (seconds) of the first sighting for a beginning, of the last one for an end."""
    place: tuple[float, float]
    """Foot point of that sighting, as fractions of the image."""
    first_t: float
    """Capture time of the first sighting, seconds."""
    edge: Edge | None = None
    value: float = 0.0
    """What was measured, in the unit that the reason names."""
    least: float = 0.0
    """What it has to be at least."""
    sightings: int = 1
    """In how many frames the track was seen."""
