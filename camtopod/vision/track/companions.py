"""People who entered side by side, merged into one blob: one track, and several heads.

Two people who walk together from the border on are one blob, and so one track. If most of the
images of it show more heads than there are tracks, and it is as wide as that many people, the
people without a track get one (`missing_track`). It has the beginning of the track with which they
were merged, so their entries have the same time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from camtopod.vision.boxes import Box, centre
from camtopod.vision.detect import Blob
from camtopod.vision.track.kalman import Kalman
from camtopod.vision.track.track import HISTORY_SIGHTINGS, Sighting, Track

CROWDED_SIGHTINGS_MIN = 4
"""Sightings with more heads than tracks after which a track is added."""
CROWDED_SHARE_MIN = 0.5
"""Least share of these among all sightings of the whole blob."""
OCCLUDED_WIDTHS_MAX = 0.65
"""Widths of one person by which people side by side may occlude each other."""
ABREAST_HEIGHTS_MAX = 0.7
"""Largest width for each head (heights); wider objects are vehicles, not people."""
TALLER_MAX = 1.3
"""Largest height of people side by side, as a share of the height of one."""


def count_heads(
    blob: Blob, held: list[Track], usual_width: float, usual_height: float | None
) -> bool:
    """Count a sighting of a blob for its tracks; return True if it shows more people than these.

    held: confirmed tracks in the blob, at least one.
    usual_width: width of one person of the blob's height, pixels.
    usual_height: height of a person at this place, pixels; None if unknown.
    """
    many = len(blob.heads)
    crowded = (
        many > len(held)
        and usual_width * (many - OCCLUDED_WIDTHS_MAX) <= blob.width
        and blob.width <= ABREAST_HEIGHTS_MAX * many * blob.height
        and (usual_height is None or blob.height < TALLER_MAX * usual_height)
    )
    for track in held:
        track.whole_sightings += 1
        track.crowded_sightings += crowded
    return crowded


def missing_track(t: float, blob: Blob, held: list[Track]) -> Track | None:
    """Return a track, not yet numbered, for a person in the blob who has none; None if too unsure.

    t (seconds): time of the frame.
    held: confirmed tracks in the blob, fewer than it has heads. Their counts restart, and a
        single one moves to its own head.
    """
    longest = max(held, key=lambda track: track.crowded_sightings)
    least = max(CROWDED_SIGHTINGS_MIN, CROWDED_SHARE_MIN * longest.whole_sightings)
    if longest.crowded_sightings < least:
        return None
    for track in held:
        track.crowded_sightings = track.whole_sightings = 0

    # The head that is farthest from all tracks, and the track that it was taken for.
    free = max(blob.heads, key=lambda x: min(abs(x - _column(track)) for track in held))
    nearest = min(held, key=lambda track: abs(free - _column(track)))
    width = blob.width / len(blob.heads)
    added = replace(nearest)
    _move(added, t, free, width)
    if len(held) == 1:
        own = blob.heads[-1] if free == blob.heads[0] else blob.heads[0]
        _move(nearest, t, own, width)
    return added


def _move(track: Track, t: float, x: float, width: float) -> None:
    """Move the latest sighting of a track to column ``x`` and give it a width, pixels."""
    _, top, _, bottom = track.last.box
    box: Box = (x - width / 2, top, x + width / 2, bottom)
    velocity = track.kalman.velocity
    track.last = Sighting(t, (x, bottom), box)
    track.kalman = Kalman((x, top, x, bottom), track.height)
    track.kalman.velocity = velocity
    track.width = width
    track.history = deque([*list(track.history)[:-1], track.last], maxlen=HISTORY_SIGHTINGS)


def _column(track: Track) -> float:
    """Return the middle column of the latest sighting, pixels."""
    return centre(track.last.box)[0]
