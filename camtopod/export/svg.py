"""Drawing of the camera network as SVG: the page's map as a picture."""

from __future__ import annotations

import math
from typing import NamedTuple
from xml.sax.saxutils import escape

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
_ALONG = (0.5, 0.4, 0.6, 1 / 3, 2 / 3)
"""Where on a line its times may be written, best first, as shares of its length."""
_SIDES = ((0, 1), (0, -1), (1, 0), (-1, 0))
"""Sides of a circle where the camera's name may be written: below, above, right, left."""
_STYLE = (
    "text{font:13px system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;fill:#1b1f1d;"
    "paint-order:stroke;stroke:#fff;stroke-width:4px;stroke-linejoin:round}"
    ".time{font-size:12px;fill:#4a544f}.title{font-size:15px;font-weight:600}"
)

Point = tuple[float, float]


class _Box(NamedTuple):
    """A rectangle that a text or circle takes up."""

    left: float
    top: float
    right: float
    bottom: float

    def hits(self, other: _Box) -> bool:
        """Return True if two boxes have an area in common."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
        )


def to_svg(topology: Topology) -> str:
    """Return the drawing: cameras as circles, overlaps as black lines, unseen paths as grey ones.

    The wider a line, the more objects take it. On an unseen path are its most frequent transit
    times in both directions; tooltips say which is which.
    """
    # One line for both directions of a pair.
    both: dict[tuple[str, str], list[Edge]] = {}
    for edge in edges(topology):
        both.setdefault((min(edge.from_, edge.to), max(edge.from_, edge.to)), []).append(edge)

    # Positions, with a margin for names.
    joined = {pair: any(way.overlapped for way in ways) for pair, ways in both.items()}
    at = places((camera.id for camera in topology.cameras), joined, {})
    left, top = (min((place[axis] for place in at.values()), default=0.0) for axis in (0, 1))
    right, bottom = (max((place[axis] for place in at.values()), default=0.0) for axis in (0, 1))
    where = {
        name: (MARGIN[0] + (x - left) * UNIT, MARGIN[1] + (y - top) * UNIT)
        for name, (x, y) in at.items()
    }
    width = max(2 * MARGIN[0] + (right - left) * UNIT, 420.0)
    height = 2 * MARGIN[1] + (bottom - top) * UNIT + LINE

    # Lines, circles, then texts where they hit nothing.
    title = f"{topology.site}, version {topology.version}, {topology.events:,} events"
    taken = [_Box(x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS) for x, y in where.values()]
    names = [_name(name, where[name], both, where, taken) for name in sorted(where)]
    most = max((sum(way.transitions for way in ways) for ways in both.values()), default=1.0)
    lines = [_line(where[a], where[b], ways, most) for (a, b), ways in sorted(both.items())]
    times = [_times(where[a], where[b], ways, taken) for (a, b), ways in _busiest_first(both)]
    zones = {camera.id: len(camera.zones) for camera in topology.cameras}
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}">',
            f"<title>{_shown(title)}</title><style>{_STYLE}</style>",
            f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>',
            f'<text class="title" x="16" y="26">{_shown(title)}</text>',
            *lines,
            *(_circle(name, zones[name], where[name]) for name in sorted(where)),
            *filter(None, times),
            *filter(None, names),
            _legend(height),
            "</svg>",
            "",
        ]
    )


def _shown(text: str) -> str:
    """Return text of foreign origin, escaped for XML."""
    return escape(visible(text))


def _busiest_first(
    both: dict[tuple[str, str], list[Edge]],
) -> list[tuple[tuple[str, str], list[Edge]]]:
    """Return the pairs with their directions, those with most transitions first."""
    return sorted(both.items(), key=lambda item: (-sum(w.transitions for w in item[1]), item[0]))


def _line(a: Point, b: Point, ways: list[Edge], most: float) -> str:
    """Return the line between two cameras, with both directions in its tooltip.

    most: number of transitions of the widest line.
    """
    overlapped = any(way.overlapped for way in ways)
    share = math.sqrt(sum(way.transitions for way in ways) / max(most, 1e-9))
    width = WIDTHS[0] + (WIDTHS[1] - WIDTHS[0]) * share
    tooltip = "; ".join(f"{way.from_} → {way.to} {_time(way)}" for way in ways)
    return (
        f"<g><title>{_shown(tooltip)}</title>"
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"'
        f' stroke="{STROKE[overlapped]}" stroke-width="{width:.1f}" stroke-linecap="round"/></g>'
    )


def _circle(name: str, zones: int, at: Point) -> str:
    """Return the circle of a camera."""
    tooltip = f"{name}, {zones} {'zone' if zones == 1 else 'zones'}"
    return (
        f"<g><title>{_shown(tooltip)}</title>"
        f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{RADIUS:.0f}" fill="#0f6b4f"'
        f' stroke="#ffffff" stroke-width="3"/></g>'
    )


def _name(
    name: str,
    at: Point,
    both: dict[tuple[str, str], list[Edge]],
    where: dict[str, Point],
    taken: list[_Box],
) -> str:
    """Return the name of a camera, on the free side with fewest lines; "" if no side is free."""
    # How far lines go towards each side, as the cosine of the angle between them.
    others = [where[b if a == name else a] for a, b in both if name in (a, b)]
    angles = [math.atan2(y - at[1], x - at[0]) for x, y in others]

    def crowd(side: tuple[int, int]) -> float:
        return max((math.cos(a - math.atan2(side[1], side[0])) for a in angles), default=-1.0)

    # The first free side.
    shown = name if len(name) <= 20 else name[:19] + "…"
    half = 7.5 * len(shown) / 2  # the widest characters
    for dx, dy in sorted(_SIDES, key=lambda side: round(crowd(side), 1)):
        x = at[0] + dx * (RADIUS + half + 4)
        y = at[1] + dy * (RADIUS + LINE / 2 + 2)
        box = _Box(x - half, y - LINE / 2, x + half, y + LINE / 2)
        if box.left >= 0 and not any(map(box.hits, taken)):
            taken.append(box)
            return (
                f'<text text-anchor="middle" x="{x:.1f}" y="{y + 4.5:.1f}">{_shown(shown)}</text>'
            )
    return ""


def _times(a: Point, b: Point, ways: list[Edge], taken: list[_Box]) -> str:
    """Return the transit times on a line, where they hit nothing; "" if nowhere."""
    text = " / ".join(_time(way) for way in ways if not way.overlapped)
    half = 6.2 * len(text) / 2 + 2  # characters of average width
    for share in _ALONG if text else ():
        x, y = (a[axis] + share * (b[axis] - a[axis]) for axis in (0, 1))
        box = _Box(x - half, y - LINE / 2, x + half, y + LINE / 2)
        if not any(map(box.hits, taken)):
            taken.append(box)
            return (
                f'<rect x="{box.left:.1f}" y="{box.top:.1f}" width="{2 * half:.1f}"'
                f' height="{LINE:.0f}" rx="5" fill="#ffffff"/>'
                f'<text class="time" text-anchor="middle" x="{x:.1f}" y="{y + 4:.1f}">{text}</text>'
            )
    return ""


def _time(way: Edge) -> str:
    """Return the most frequent transit time of one direction; where views overlap, that."""
    return "overlap" if way.overlapped else seconds(way.transit.mode)


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
