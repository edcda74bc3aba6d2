"""Drawing of the camera network as SVG: the page's map as a picture."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import escape

import numpy as np

from camtopod.arrays import Floats
from camtopod.export.graph import Edge, edges, seconds
from camtopod.export.layout import places
from camtopod.records import Topology
from camtopod.visible import visible

UNIT = 130.0
"""Length of an unseen path in units of the drawing (pixels, if it is not scaled)."""
RADIUS = 11.0
"""Radius of a camera's circle."""
MARGIN = (90.0, 60.0)
"""Space between the outermost cameras and the border, at the sides and above and below."""
WIDTHS = (1.2, 7.0)
"""Widths of the lines with least and most transitions."""
LINE = 16.0
"""Height of a line of text."""
STROKE = {True: "#111513", False: "#85908a"}
"""Line colour, by whether the views overlap: black and grey in the thesis."""
DASHES = "2 8"
"""Dashes of a weak link and the gaps between them."""
NAME_DISTANCE = RADIUS + LINE / 2 + 2
"""Distance of a camera's name from the middle of its circle, above or below."""
WIDTH_OF_LETTER = 7.5
"""Width of the widest letters."""
_ALONG = (0.5, 0.4, 0.6, 1 / 3, 2 / 3)
"""Where on a line its times may be written, best first, as shares of its length."""
_STYLE = (
    "text{font:13px system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;fill:#1b1f1d;"
    "paint-order:stroke;stroke:#fff;stroke-width:4px;stroke-linejoin:round}"
    ".time{font-size:12px;fill:#4a544f}.title{font-size:15px;font-weight:600}"
)

Point = Sequence[float] | Floats
"""Position (x, y) in units of the drawing."""
Box = tuple[float, float, float, float]
"""Left, top, right and bottom of what takes up room."""


def to_svg(topology: Topology) -> str:
    """Return the drawing: cameras as circles, overlaps as black lines, unseen paths as grey ones.

    The wider a line, the more objects take it; weak links are dashed. On an unseen path are its
    most frequent transit times in both directions; tooltips say which is which.
    """
    # One line for both directions of a pair, those with most transitions first.
    pairs: dict[tuple[str, str], list[Edge]] = defaultdict(list)
    for edge in edges(topology):
        pairs[min(edge.from_, edge.to), max(edge.from_, edge.to)].append(edge)
    rows = sorted(pairs.items(), key=lambda item: -sum(way.transitions for way in item[1]))

    # Positions, with a margin for names.
    layout_edges = {pair: any(way.overlapped for way in ways) for pair, ways in pairs.items()}
    at = places((camera.id for camera in topology.cameras), layout_edges, {})
    coordinates = np.array([*at.values()]).reshape(-1, 2)
    low = coordinates.min(0, initial=np.inf)
    points = {name: (np.array(place) - low) * UNIT + MARGIN for name, place in at.items()}
    width, height = np.max([(420.0, 0.0), *points.values()], axis=0) + MARGIN + (0.0, LINE)

    # Lines, circles, then texts where they hit nothing.
    title = _shown(f"{topology.site}, version {topology.version}, {topology.events:,} events")
    transitions_max = max((sum(way.transitions for way in ways) for _, ways in rows), default=1.0)
    texts = _Texts([(x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS) for x, y in points.values()])
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}">',
        f"<title>{title}</title><style>{_STYLE}</style>",
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>',
        f'<text class="title" x="16" y="26">{title}</text>',
    ]
    lines += [_line(points[a], points[b], ways, transitions_max) for (a, b), ways in rows]
    for camera in topology.cameras:
        at_camera = points[camera.id]
        lines.append(_circle(f"{camera.id}, zones: {len(camera.zones)}", at_camera))
        sides = [(at_camera[0], at_camera[1] + side * NAME_DISTANCE) for side in (1, -1)]
        texts.write(camera.id[:20], sides, "name")
    for (a, b), ways in rows:
        text = " / ".join(_time(way) for way in ways if not way.overlapped)
        along = [points[a] + share * (points[b] - points[a]) for share in _ALONG]
        texts.write(text, along, "time")
    return "\n".join([*lines, *texts.lines, _legend(height), "</svg>", ""])


class _Texts:
    """Texts of the drawing, each where it hits none before, and none of the circles.

    boxes: left, top, right and bottom of each circle.
    """

    def __init__(self, boxes: list[Box]) -> None:
        self.lines: list[str] = []
        self._boxes = boxes

    def write(self, text: str, middles: Iterable[Point], kind: str) -> None:
        """Write a text at the first of the places where it is free; nowhere if none is."""
        half = 0.5 * WIDTH_OF_LETTER * len(text)
        for x, y in middles:
            box = (x - half, y - LINE / 2, x + half, y + LINE / 2)
            if text and not any(_hits(box, obstacle) for obstacle in self._boxes):
                self._boxes.append(box)
                self.lines.append(
                    f'<text class="{kind}" text-anchor="middle" x="{x:.1f}" y="{y + 4.5:.1f}">'
                    f"{_shown(text)}</text>"
                )
                break


def _hits(a: Box, b: Box) -> bool:
    """Return True if two boxes have an area in common."""
    apart = a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
    return not apart


def _shown(text: str) -> str:
    """Return text of foreign origin, escaped for XML."""
    return escape(visible(text))


def _line(a: Point, b: Point, ways: list[Edge], transitions_max: float) -> str:
    """Return the line between two cameras, with both directions in its tooltip.

    transitions_max: number of transitions of the widest line.
    """
    is_overlap = any(way.overlapped for way in ways)
    dashes = f' stroke-dasharray="{DASHES}"' if all(way.weak for way in ways) else ""
    share = math.sqrt(sum(way.transitions for way in ways) / max(transitions_max, 1e-9))
    width = WIDTHS[0] + (WIDTHS[1] - WIDTHS[0]) * share
    tooltip = "; ".join(f"{way.from_} → {way.to} {_time(way)}" for way in ways)
    return (
        f"<g><title>{_shown(tooltip)}</title>"
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"'
        f' stroke="{STROKE[is_overlap]}" stroke-width="{width:.1f}"{dashes}'
        ' stroke-linecap="round"/></g>'
    )


def _circle(tooltip: str, at: Point) -> str:
    """Return the circle of a camera."""
    return (
        f"<g><title>{_shown(tooltip)}</title>"
        f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{RADIUS:.0f}" fill="#0f6b4f"'
        f' stroke="#ffffff" stroke-width="3"/></g>'
    )


def _time(way: Edge) -> str:
    """Return the most frequent transit time of one direction; where views overlap, that."""
    if way.overlapped:
        return "overlap"
    return seconds(way.transit.mode)


def _legend(height: float) -> str:
    """Return the legend."""
    y = height - 18
    return (
        f'<g><line x1="16" y1="{y:.0f}" x2="44" y2="{y:.0f}"'
        f' stroke="{STROKE[True]}" stroke-width="3"/>'
        f'<text class="time" x="50" y="{y + 4:.0f}">views overlap</text>'
        f'<line x1="146" y1="{y:.0f}" x2="174" y2="{y:.0f}"'
        f' stroke="{STROKE[False]}" stroke-width="3"/>'
        f'<text class="time" x="180" y="{y + 4:.0f}">unseen path, most frequent time</text></g>'
    )
