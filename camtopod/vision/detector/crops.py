"""Crops for a detector's model: parts of the image around motion and standing people.

A crop has the shape of the model's input, so that a small person far away fills more of it than of
the whole image. Regions close to each other share a crop; if there are more crops than inferences,
those wait that were examined last.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from math import inf
from statistics import median_high

import numpy as np

from camtopod.vision.boxes import Box, Size, area, box_height, centre, grid_cell, union

MARGIN_HEIGHTS = 0.5
"""Margin around a region (heights of the region): motion shows some of a person only."""
HEIGHT_GOOD = 0.16
"""Height of a region, as a share of a crop's height, down to which regions share a crop freely."""
HEIGHT_MIN = 0.08
"""The same where there are fewer inferences than crops; lower ones are often missed."""
ENLARGED_MAX = 3.0
"""Largest factor by which a crop is enlarged: beyond it there is no more detail."""
REGIONS_MAX = 24
"""Regions that are examined, the largest."""
GRID = (8, 8)
"""Rows and columns of the cells that remember when they were examined."""


class Crops:
    """Plans the crops of one view."""

    def __init__(self, size: Size, input_size: Size) -> None:
        """Prepare for images of ``size`` and a model with inputs of ``input_size`` pixels.

        Both are (width, height).
        """
        self.size = size
        self._input = input_size
        self._examined = np.full(GRID, -inf)
        """Time of the latest inference at each cell, seconds."""

    def plan(self, t: float, regions: Sequence[Box], inferences: int) -> list[Box]:
        """Return at most ``inferences`` crops that hold regions, most urgent first.

        t (seconds): capture time.
        regions, result: in pixels of the image; crops may reach out of it.
        """
        if not regions or inferences < 1:
            return []
        groups = [[one] for one in sorted(regions, key=area, reverse=True)[:REGIONS_MAX]]
        groups = self._merged(groups, HEIGHT_GOOD, 1)
        if len(groups) > inferences:
            groups = self._merged(groups, HEIGHT_MIN, inferences)

        # Those that have waited for longest come first, larger ones before smaller ones.
        order = sorted(groups, key=lambda group: (self._waits_since(group), -len(group)))
        crops = []
        for group in order[:inferences]:
            for region in group:
                self._examined[self._cell(region)] = t
            crops.append(self._crop(group))
        return crops

    def _merged(self, groups: list[list[Box]], least: float, number: int) -> list[list[Box]]:
        """Merge groups until there are ``number``, the pair that needs the smallest crop first.

        least: the regions of a group keep at least this share of its crop's height, by their
            median.
        """
        groups = list(groups)
        while len(groups) > number:
            best = None
            best_side = inf
            for i in range(len(groups)):
                for j in range(i):
                    group = groups[i] + groups[j]
                    crop = self._crop(group)
                    side = box_height(crop)
                    if side < best_side and median_high(map(box_height, group)) >= least * side:
                        best = (i, j)
                        best_side = side
            if best is None:
                break
            i, j = best
            merged = groups[i] + groups[j]
            groups = [group for k, group in enumerate(groups) if k not in best] + [merged]
        return groups

    def _crop(self, group: Sequence[Box]) -> Box:
        """Return the crop for some regions, inside of the image if it fits."""
        left, top, right, bottom = reduce(union, group)
        margin = MARGIN_HEIGHTS * max(map(box_height, group))

        # Height of the crop, in the shape of the input, not larger than the whole image needs.
        aspect = self._input[0] / self._input[1]
        height = max(bottom - top + 2 * margin, (right - left + 2 * margin) / aspect)
        height = max(height, self._input[1] / ENLARGED_MAX)
        height = min(height, max(self.size[1], self.size[0] / aspect))
        width = height * aspect

        # Around the regions, moved into the image.
        x = _placed((left + right - width) / 2, width, self.size[0])
        y = _placed((top + bottom - height) / 2, height, self.size[1])
        return (x, y, x + width, y + height)

    def _waits_since(self, group: Sequence[Box]) -> float:
        return min(float(self._examined[self._cell(region)]) for region in group)

    def _cell(self, region: Box) -> tuple[int, int]:
        """Return the cell (row, column) of a region's middle."""
        return grid_cell(*centre(region), self.size, GRID)


def whole(size: Size, input_size: Size) -> Box:
    """Return the crop that holds the whole image of ``size`` (width, height), in its middle."""
    aspect = input_size[0] / input_size[1]
    height = max(size[1], size[0] / aspect)
    x, y = (size[0] - height * aspect) / 2, (size[1] - height) / 2
    return (x, y, x + height * aspect, y + height)


def _placed(start: float, length: float, whole_length: float) -> float:
    """Return where a crop of ``length`` begins that is inside of the image, or in its middle."""
    if length >= whole_length:
        return (whole_length - length) / 2
    return min(max(start, 0.0), whole_length - length)
