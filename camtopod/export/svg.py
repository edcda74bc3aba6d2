"""Drawing of the camera network as SVG: the page's map as a picture."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape

import numpy as np

from camtopod.arrays import Bools, Floats
from camtopod.export.graph import Edge, edges, seconds
from camtopod.export.layout import places
from camtopod.records import Topology
from camtopod.visible import visible

UNIT = 150.0
"""Length of an unseen path in pixels, as all lengths here."""
RADIUS = 11.0
"""Radius of a camera's circle."""
MARGIN = 20.0
"""Space around the drawing."""
WIDTHS = (1.2, 7.0)
"""Widths of the lines with least and most transitions."""
ROW = 18.0
"""Height of a line of text."""
STROKE = {True: "#111513", False: "#85908a"}
"""Line colour, by whether the views overlap: black and grey in the thesis."""
DASHES = ' stroke-dasharray="2 8"'
"""Dashes of a weak link and the gaps between them."""
LETTERS = {"name": 8.0, "time": 6.5}
"""Mean width of a letter, by kind of text, in wide fonts."""
AIR = 2.0
"""Space between a text and what is beside it."""
SIDES = np.array([(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)])
"""Where a camera's name may be, best first: below it, above, right, left, and between these."""
ALONG = (0.5, 0.4, 0.6, 1 / 3, 2 / 3)
"""Where beside a line its times may be, best first, as shares of its length."""
ARROWS = "→↘↓↙←↖↑↗"
"""Directions by eighths of a turn, y downwards."""
_STYLE = (
    "text{font:13px system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;fill:#1b1f1d;"
    "paint-order:stroke;stroke:#fff;stroke-width:3px;stroke-linejoin:round}"
    ".time{font-size:12px;fill:#4a544f}.title{font-size:15px;font-weight:600}"
)


class _Line(NamedTuple):
    """The line of a pair of cameras, ``a`` and another one: from ``start`` to ``start + way``."""

    a: str
    start: Floats
    way: Floats
    width: float
    edges: Sequence[Edge]


def to_svg(topology: Topology) -> str:
    """Return the drawing: cameras as circles, overlaps as black lines, unseen paths as grey ones.

    The wider a line, the more objects take it; weak links are dashed. Beside an unseen path are its
    most frequent transit times, each with an arrow in its direction; tooltips name the cameras.
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
        lines.append(_Line(a, points[a], points[b] - points[a], width, pairs[a, b]))

    # Times, then names, for which there are more places, where they hit nothing.
    texts = _Texts(lines, points.values())
    for line in lines:
        texts.write_times(line)
    for name, point in points.items():
        texts.write_name(name[:20], point)

    # The title above, the legend below.
    title = _shown(f"{topology.site}, version {topology.version}, {topology.events:,} events")
    keys = ["views overlap", "unseen path, most frequent times; the wider, the more objects"]
    if any(edge.weak for line in lines for edge in line.edges):
        keys.append("likely, not published yet")
    low, high = texts.bounds()
    left, top = low - (MARGIN, MARGIN + 2 * ROW)
    width = max(high[0] - left + MARGIN, LETTERS["name"] * max(len(title), len(keys[1])))
    height = high[1] - top + MARGIN + ROW * len(keys)
    elements = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}"'
        ' style="max-width:100%;max-height:100%"'
        f' viewBox="{left:.0f} {top:.0f} {width:.0f} {height:.0f}">',
        f"<title>{title}</title><style>{_STYLE}</style>",
        f'<rect x="{left:.0f}" y="{top:.0f}" width="100%" height="100%" fill="#ffffff"/>',
        f'<text class="title" x="{left + MARGIN:.0f}" y="{top + 26:.0f}">{title}</text>',
        *map(_drawn, lines),
        *(
            _circle(f"{camera.id}, zones: {len(camera.zones)}", points[camera.id])
            for camera in topology.cameras
        ),
        *texts.elements,
    ]
    for k, key in enumerate(keys):
        x, y = left + MARGIN, high[1] + MARGIN + ROW * k
        stroke = _stroke(np.array((x, y)), np.array((x + 28, y)), k == 0, 3.0, weak=k == 2)
        elements.append(f'{stroke}<text class="time" x="{x + 36:.0f}" y="{y + 4:.0f}">{key}</text>')
    return "\n".join([*elements, "</svg>", ""])


class _Texts:
    """Texts of the drawing, each where it hits no circle, no line and no text before it.

    What a text may hit are segments with a reach around them: lines, circles, and the texts.
    """

    def __init__(self, lines: Sequence[_Line], points: Iterable[Floats]) -> None:
        rows = [(*line.start, *line.way, line.width / 2) for line in lines]
        rows += [(*point, 0.0, 0.0, RADIUS) for point in points]
        self._segments = np.array(rows or [(0.0,) * 5]).T
        self._line_count = len(lines)
        self.elements: list[str] = []

    def write_name(self, name: str, point: Floats) -> None:
        """Write a camera's name beside its circle; across lines if it must be."""
        room = RADIUS + AIR + 0.5
        middles = point + SIDES * (0.5 * LETTERS["name"] * len(name) + room, ROW / 2 + room)
        if not self._write(name, "name", middles):
            self._write(name, "name", middles, self._line_count)

    def write_times(self, line: _Line) -> None:
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
                self.elements.append(
                    f'<text class="{kind}" text-anchor="middle" x="{x:.1f}" y="{y + 4.5:.1f}">'
                    f"{_shown(text)}</text>"
                )
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


def _shown(text: str) -> str:
    """Return text of foreign origin, escaped for XML."""
    return escape(visible(text))


def _drawn(line: _Line) -> str:
    """Return the line between two cameras, with both directions in its tooltip."""
    tooltip = "; ".join(
        f"{edge.from_} → {edge.to} "
        + ("overlap" if edge.overlapped else seconds(edge.transit.mode))
        for edge in line.edges
    )
    return (
        f"<g><title>{_shown(tooltip)}</title>"
        + _stroke(
            line.start,
            line.start + line.way,
            any(edge.overlapped for edge in line.edges),
            line.width,
            all(edge.weak for edge in line.edges),
        )
        + "</g>"
    )


def _stroke(start: Floats, end: Floats, overlapped: bool, width: float, weak: bool) -> str:
    """Return a line, black if views overlap, dashed if it is weak."""
    return (
        f'<line x1="{start[0]:.1f}" y1="{start[1]:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}"'
        f' stroke="{STROKE[overlapped]}" stroke-width="{width:.1f}"{DASHES * weak}'
        ' stroke-linecap="round"/>'
    )


def _circle(tooltip: str, at: Floats) -> str:
    """Return the circle of a camera."""
    return (
        f"<g><title>{_shown(tooltip)}</title>"
        f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{RADIUS:.0f}" fill="#0f6b4f"'
        f' stroke="#ffffff" stroke-width="3"/></g>'
    )
