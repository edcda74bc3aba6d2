"""Detect two people who change places at the border: one leaves while another enters.

If their blobs never separate, the tracker sees one object that walks out of the view and, half out
of it, comes back at once. A person who turns round slows down first. A blob that shrinks
into the border and grows out of it again, at walking speed both times, is therefore taken for two
people.
"""

from __future__ import annotations

from collections.abc import Sequence

from camtopod.vision.boxes import TOUCH_PIXELS, Size, border_distances
from camtopod.vision.track.track import Sighting

CHANGE_HEIGHTS = 0.35
"""Distance (heights) that the blob must draw back to the border and come out again."""
CHANGE_SECONDS = 1.3
"""Longest time of each of these two movements."""
SPEED_MAX = 2.5
"""Largest speed of these movements, heights per second.

People walk about one height per second; faster changes are blobs that merged or split.
"""
LEFT_SHARE = 1.0
"""Largest share of a person's width (at the sides) or height in view at the turning point."""


def find_swap(history: Sequence[Sighting], size: Size, width: float, height: float) -> int | None:
    """Return the index of the sighting at which one person replaced another at the border, or None.

    size: width and height of the image, pixels.
    width, height: those of a person, pixels.
    """
    for side in range(4):
        # Turning point: the sighting with the least extent into the view.
        whole = width if side in (0, 2) else height
        boxes = [sighting.box for sighting in history]
        into = [(box[2], box[3], size[0] - box[0], size[1] - box[1])[side] for box in boxes]
        turn = min(range(len(into)), key=into.__getitem__)
        if not 0 < turn < len(into) - 1 or into[turn] > LEFT_SHARE * whole:
            continue
        if border_distances(history[turn].box, size)[side] > TOUCH_PIXELS:
            continue

        # It must draw back and come out far enough.
        t = history[turn].t
        near = [i for i, sighting in enumerate(history) if abs(sighting.t - t) <= CHANGE_SECONDS]
        before = max(into[i] for i in near if i <= turn)
        after = max(into[i] for i in near if i >= turn)
        if min(before, after) - into[turn] < CHANGE_HEIGHTS * height:
            continue

        # At walking speed both times.
        steps = [(into[i + 1] - into[i]) / (history[i + 1].t - history[i].t) for i in near[:-1]]
        if max(map(abs, steps)) <= SPEED_MAX * height:
            return turn
    return None
