"""Assignment of the blobs of a frame to the tracks of an object each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot

import numpy as np
from scipy.optimize import linear_sum_assignment

from camtopod.vision.boxes import area, box_height, centre
from camtopod.vision.detect import Blob
from camtopod.vision.track.crossings import Crossings, FrameView
from camtopod.vision.track.kalman import SIGMAS
from camtopod.vision.track.stature import Stature
from camtopod.vision.track.track import Track

GATE_HEIGHTS = 0.35
"""Gate: largest distance (heights, plus two sigma) of head or foot from the expected position."""
LIKE_FACTOR = 2.0
"""Largest factor between the areas, or heights, of one object that no border cuts."""
NEARER_SHARE = 0.7
"""Weight in the cost of an assignment of the one of head and foot that is nearer."""
SPEED_MAX = 10.0
"""Largest speed of an object that was seen but once, heights per second."""
_NEVER = 1e9
"""Cost of an assignment that is not allowed."""

Costs = Callable[[Track, Sequence[Blob]], list[float]]
"""Cost of each blob for a track; `_NEVER` where it is not allowed."""


def best_pairs(
    frame: FrameView,
    tracks: Sequence[Track],
    blobs: Sequence[Blob],
    costs: Costs,
    crossings: Crossings,
) -> list[tuple[Track, Blob]]:
    """Return the pairs of track and blob with the least total cost (Kuhn 1955)."""
    if not tracks or not blobs:
        return []
    cost = np.array([costs(track, blobs) for track in tracks])
    for i, j in np.argwhere(cost < _NEVER):
        if crossings.comes_in(frame, tracks[i], blobs[j].box):
            cost[i, j] = _NEVER
    best = zip(*linear_sum_assignment(cost), strict=True)
    return [(tracks[i], blobs[j]) for i, j in best if cost[i, j] < _NEVER]


def costs_by_points(track: Track, blobs: Sequence[Blob], stature: Stature) -> list[float]:
    """Return for each blob the distance of head and foot in gates.

    Tentative tracks have a higher cost, so that they yield to confirmed ones.
    """
    head_x, head_y, foot_x, foot_y = track.kalman.position
    size = max(track.size, stature.height(foot_y) or 0.0)
    gate = GATE_HEIGHTS * size + SIGMAS * track.kalman.uncertainty

    costs = [_NEVER] * len(blobs)
    for j, blob in enumerate(blobs):
        head = hypot((blob.left + blob.right) / 2 - head_x, blob.top - head_y)
        foot = hypot(blob.foot_x - foot_x, blob.bottom - foot_y)
        near = min(head, foot)
        if near <= gate:
            distance = NEARER_SHARE * near + (1 - NEARER_SHARE) * max(head, foot)
            costs[j] = distance / gate + (not track.confirmed) / 2
    return costs


def costs_by_area(
    frame: FrameView, track: Track, blobs: Sequence[Blob], dt: float, crossings: Crossings
) -> list[float]:
    """Return for each blob of like area the distance of its middle, as a share of the reach.

    For what the first pass leaves: objects that move by more than a gate in ``dt`` seconds from
    frame to frame, or whose head and foot jump because the border cuts them or fragments come and
    go.
    """
    costs = [_NEVER] * len(blobs)
    box = track.last.box

    # One step at its speed, or the jump of its outline.
    head_x, head_y, foot_x, foot_y = track.kalman.velocity
    speed = hypot(head_x + foot_x, head_y + foot_y) / 2
    if track.sightings == 1:
        speed = SPEED_MAX * track.height
    cut = crossings.touches(frame, box)
    reach = max(
        dt * speed,
        box[2] - box[0],
        box_height(box) / (1 if cut else 2),
    )
    middles = [centre(box), centre(track.box)]
    for j, blob in enumerate(blobs):
        x, y = centre(blob.box)
        distance = min(hypot(x - a, y - b) for a, b in middles)
        if distance > reach:
            continue
        low, high = sorted((area(blob.box), area(box)))
        if high <= LIKE_FACTOR * low or cut or crossings.touches(frame, blob.box):
            costs[j] = distance / reach
    return costs
