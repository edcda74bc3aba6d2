"""Heads in the outline of a blob: people side by side make one blob with several heads.

A head is a peak of the outline near its top, with a valley on either side (I. Haritaoglu,
D. Harwood and L. Davis, 1999: Hydra: multiple people detection and tracking using silhouettes).
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Bools

HEIGHT_MIN_PIXELS = 16
"""Least height of a blob in which heads are searched, pixels."""
APART_HEIGHTS = 0.18
"""Least distance between two heads (heights of the blob)."""
TOP_HEIGHTS = 0.3
"""Largest distance of a head's peak from the top of the blob (heights of the blob)."""
VALLEY_HEIGHTS = 0.1
"""Least depth of the valley between two heads (heights of the blob)."""


def find_heads(mask: Bools) -> list[int]:
    """Return the columns of the heads in an outline, from left to right; empty if below two.

    mask (H, W): pixels of the blob, in its box.
    """
    height, width = mask.shape
    apart = APART_HEIGHTS * height
    valley = VALLEY_HEIGHTS * height
    if height < HEIGHT_MIN_PIXELS or width < apart:
        return []

    # Distance of the outline from the top of the box, by column.
    depth: list[int] = np.where(mask.any(axis=0), mask.argmax(axis=0), height).tolist()

    # A peak begins where the outline has risen by a valley, and ends where it has fallen by one.
    heads: list[int] = []
    deepest = height
    peak = -1
    for column, now in enumerate([*depth, height]):
        if peak < 0:
            deepest = max(deepest, now)
            if now <= TOP_HEIGHTS * height and deepest - now >= valley:
                peak = column
        elif now < depth[peak]:
            peak = column
        elif now - depth[peak] >= valley:
            middle = _middle_of_peak(depth, peak)
            if not heads or middle - heads[-1] >= apart:
                heads.append(middle)
            deepest = now
            peak = -1
    return heads if len(heads) > 1 else []


def _middle_of_peak(depth: list[int], peak: int) -> int:
    """Return the middle column of the flat top that begins at ``peak``."""
    last = peak
    while last + 1 < len(depth) and depth[last + 1] <= depth[peak] + 1:
        last += 1
    return (peak + last) // 2
