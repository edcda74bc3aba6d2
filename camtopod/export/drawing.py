"""Drawing of a camera network, for SVG and matplotlib: lines, circles, and texts clear of them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Bools, Floats
from camtopod.export.graph import Edge, edges, seconds
from camtopod.export.layout import places
from camtopod.records import Topology

UNIT = 150.0
"""Length of an unseen path in pixels, as all lengths here."""
RADIUS = 11.0
"""Radius of a camera's circle."""
WIDTHS = (1.2, 7.0)
"""Widths of the lines with least and most transitions."""
ROW = 18.0
"""Height of a line of text."""
LETTERS = {"name": 8.0, "time": 6.5}
"""Mean width of a letter, by kind of text, in wide fonts."""
AIR = 2.0
"""Least gap between a text and other parts of the drawing, pixels."""
SIDES = np.array([(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)])
"""Where a camera's name may be, best first: below it, above, right, left, and between these."""
ALONG = (0.5, 0.4, 0.6, 1 / 3, 2 / 3)
"""Where beside a line its times may be, best first, as shares of its length."""
ARROWS = "→↘↓↙←↖↑↗"
"""Directions by eighths of a turn, y downwards."""


class PairLine(NamedTuple):
    """The line of a pair of cameras, ``a`` and another one: from ``start`` to ``start + way``."""

    a: str
    start: Floats
    way: Floats
    width: float
    edges: Sequence[Edge]

    @property
    def overlapped(self) -> bool:
        """Whether the views of the two cameras overlap."""
        return any(edge.overlapped for edge in self.edges)

    @property
    def weak(self) -> bool:
        """Whether no link of the two is published."""
        return all(edge.weak for edge in self.edges)


class Text(NamedTuple):
    """The name of a camera, or the times of a line; x and y are of its middle."""

    text: str
    kind: str
    x: float
    y: float


class Drawing(NamedTuple):
    """All that is drawn; ``low`` and ``high`` (2,) are the corners of the box around it.

    points: place of each camera. y grows downwards.
    """

    points: dict[str, Floats]
    lines: list[PairLine]
    texts: list[Text]
    low: Floats
    high: Floats


def draw(topology: Topology) -> Drawing:
    """Return the drawing of the camera network.

    The wider a line, the more objects take it. Beside an unseen path are its most frequent transit
    times, each with an arrow in its direction.
    """
    # Positions, and one line for both directions of a pair, those with most transitions first.
    pairs: dict[tuple[str, str], list[Edge]] = defaultdict(list)
    for edge in edges(topology):
        pairs[min(edge.from_, edge.to), max(edge.from_, edge.to)].append(edge)
    overlaps = {pair: any(way.overlapped for way in ways) for pair, ways in pairs.items()}
    numbers = {pair: sum(way.transitions for way in ways) for pair, ways in pairs.items()}
    at = places((camera.id for camera in topology.cameras), overlaps, {})
    points = {name: UNIT * np.array(place) for name, place in at.items()}
    lines = []
    for a, b in sorted(numbers, key=lambda pair: -numbers[pair]):
        share = math.sqrt(numbers[a, b] / max(*numbers.values(), 1e-9))
        width = WIDTHS[0] + (WIDTHS[1] - WIDTHS[0]) * share
        lines.append(PairLine(a, points[a], points[b] - points[a], width, pairs[a, b]))

    # Times, then names, for which there are more places, where they hit nothing.
    texts = _Texts(lines, points.values())
    for line in lines:
        texts.write_times(line)
    for name, point in points.items():
        texts.write_name(name[:20], point)
    return Drawing(points, lines, texts.texts, *texts.bounds())


class _Texts:
    """Texts of the drawing, each where it hits no circle, no line and no text before it.

    What a text may hit are segments with a reach around them: lines, circles, and the texts.
    """

    def __init__(self, lines: Sequence[PairLine], points: Iterable[Floats]) -> None:
        rows = [(*line.start, *line.way, line.width / 2) for line in lines]
        rows += [(*point, 0.0, 0.0, RADIUS) for point in points]
        self._segments = np.array(rows or [(0.0,) * 5]).T
        self._line_count = len(lines)
        self.texts: list[Text] = []

    def write_name(self, name: str, point: Floats) -> None:
        """Write a camera's name beside its circle; across lines if it must be."""
        room = RADIUS + AIR + 0.5
        middles = point + SIDES * (0.5 * LETTERS["name"] * len(name) + room, ROW / 2 + room)
        if not self._write(name, "name", middles):
            self._write(name, "name", middles, self._line_count)

    def write_times(self, line: PairLine) -> None:
        """Write the most frequent times of unseen paths beside their line, each with its arrow."""
        eighth = round(math.atan2(line.way[1], line.way[0]) / (math.pi / 4))
        text = " ".join(
            f"{ARROWS[(eighth + 4 * (edge.from_ != line.a)) % 8]} {seconds(edge.transit.mode)}"
            for edge in line.edges
            if not edge.overlapped
        )
        across = np.array((-line.way[1], line.way[0])) / max(math.hypot(*line.way), 1e-9)
        room = line.width / 2 + AIR + 0.5
        aside = abs(across) @ (0.5 * LETTERS["time"] * len(text) + room, ROW / 2 + room)
        middles = [
            line.start + share * line.way + side * across
            for side in (-aside, aside, -aside - ROW, aside + ROW)
            for share in ALONG
        ]
        self._write(text, "time", np.array(middles))

    def _write(self, text: str, kind: str, middles: Floats, first_segment: int = 0) -> bool:
        """Write a text at the first of n places where it is free; return whether there is one.

        middles (n, 2): the places. first_segment: of those that it may not hit.
        """
        size = np.array((0.5 * LETTERS[kind] * len(text), ROW / 2))
        segments = self._segments[:, first_segment:]
        low, high = middles.min(0) - size, middles.max(0) + size
        near = segments[:, _hit((low + high) / 2, (high - low) / 2, segments)]
        for x, y in middles:
            if text and not _hit(np.array((x, y)), size, near).any():
                row = [[x - size[0]], [y], [2 * size[0]], [0.0], [ROW / 2]]
                self._segments = np.hstack([self._segments, row])
                self.texts.append(Text(text, kind, x, y))
                return True
        return False

    def bounds(self) -> tuple[Floats, Floats]:
        """Return the least and greatest x and y of all that is drawn."""
        ends = self._segments[:2], self._segments[:2] + self._segments[2:4]
        reach = self._segments[4]
        return (np.minimum(*ends) - reach).min(1), (np.maximum(*ends) + reach).max(1)


def _hit(middle: Floats, half: Floats, segments: Floats) -> Bools:
    """Return which segments (5, n) a box hits, (n,): those of which a part is within it.

    middle, half (2,): of the box, its middle and half of its size.
    """
    size = half[:, None] + segments[4] + AIR
    way = np.where(segments[2:4] == 0.0, 1e-9, segments[2:4])
    from_middle = segments[:2] - middle[:, None]
    ends = (-size - from_middle) / way, (size - from_middle) / way
    begin, end = np.minimum(*ends).max(0), np.maximum(*ends).min(0)
    hit: Bools = np.maximum(begin, 0.0) < np.minimum(end, 1.0)
    return hit
