"""Two people who meet at the border: one leaves while another comes in, and their blobs never part.

The tracker sees one object that walks out of the view and, half out of it, shoots back in. Somebody
who really turns round slows down first; so a blob that shrinks into the border and grows out of it
again at walking speed both times is taken for two people.
"""

from __future__ import annotations

from collections.abc import Sequence

from camtopod.vision.detect import Box
from camtopod.vision.track.track import Sighting

CHANGE_HEIGHTS = 0.35
"""So far the blob must draw back to the border, and come out again,"""
CHANGE_SECONDS = 1.3
"""each within this time."""
SPEED_MAX = 2.5
"""Heights per second. People walk about one; what changes faster is a blob that merged or split."""
LEFT_SHARE = 1.0
"""When it is smallest, at most this share of a person's width (at the sides) or height is in
view.
"""


def find_handover(
    history: Sequence[Sighting], size: tuple[int, int], width: float, height: float
) -> int | None:
    """Index of the sighting at which one person took another's place at the border, if so.

    ``size`` of the picture, ``width`` and ``height`` of a person, pixels.
    """
    for side in range(4):
        whole = width if side in (0, 2) else height
        into = [_into_view(sighting.box, side, size) for sighting in history]
        turn = min(range(len(into)), key=into.__getitem__)
        if not 0 < turn < len(into) - 1 or into[turn] > LEFT_SHARE * whole:
            continue
        if not touches_side(history[turn].box, side, size):
            continue
        t = history[turn].t
        near = [i for i, sighting in enumerate(history) if abs(sighting.t - t) <= CHANGE_SECONDS]
        before = max(into[i] for i in near if i <= turn)
        after = max(into[i] for i in near if i >= turn)
        if min(before, after) - into[turn] < CHANGE_HEIGHTS * height:
            continue
        steps = [(into[i + 1] - into[i]) / (history[i + 1].t - history[i].t) for i in near[:-1]]
        if max(map(abs, steps)) <= SPEED_MAX * height:
            return turn
    return None


def _into_view(box: Box, side: int, size: tuple[int, int]) -> float:
    """How far the box reaches into the view from its left, top, right or bottom (0 to 3),
    pixels.
    """
    return (box[2], box[3], size[0] - box[0], size[1] - box[1])[side]


def touches_side(box: Box, side: int, size: tuple[int, int], pixels: float = 1.5) -> bool:
    """Whether the box is cut by that side of the picture."""
    return (box[0], box[1], size[0] - box[2], size[1] - box[3])[side] <= pixels
