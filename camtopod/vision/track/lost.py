"""Tracks that were lost in mid-view, and the later ones that continue their passages."""

from __future__ import annotations

from collections.abc import Iterable
from math import dist

from camtopod.vision.boxes import box_height
from camtopod.vision.track.assignment import LIKE_FACTOR
from camtopod.vision.track.crossings import Crossings
from camtopod.vision.track.track import Track

STITCH_SECONDS = 10.0
"""Time within which a track lost in mid-view may be found again and continue its passage."""
STITCH_HEIGHTS = 1.5
"""Distance (heights) within which it may continue: from where it was last seen, or from where it
would be by now at its last velocity."""


def earlier_part(track: Track, lost: Iterable[Track], crossings: Crossings) -> Track | None:
    """Return the nearest lost track that the new ``track`` continues; None if it continues none.

    lost: tracks that are not seen any more; those at an edge have left.
    """
    if crossings.begins_at_edge(track):
        return None

    # Nearest by distance over reach.
    best = None
    best_score = 1.0
    for other in lost:
        seconds = track.first.t - other.last.t
        if seconds <= 0.0 or crossings.at_edge(other):
            continue
        x, y = other.last.foot
        walked = (x + seconds * other.velocity[0], y + seconds * other.velocity[1])
        distance = min(dist(track.first.foot, (x, y)), dist(track.first.foot, walked))
        low, high = sorted((box_height(track.first.box), box_height(other.last.box)))
        score = distance / (STITCH_HEIGHTS * high)
        if score < best_score and high < LIKE_FACTOR * low:
            best = other
            best_score = score
    return best


def absorb(track: Track, earlier: Track) -> None:
    """Make ``track`` continue the passage ``earlier``, with its number and beginning."""
    track.number = earlier.number
    track.first = earlier.first
    track.from_start = earlier.from_start
    track.cells |= earlier.cells
    track.beside_others = earlier.beside_others
