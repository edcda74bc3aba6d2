"""The camera network as SVG: the page's map as a picture."""

from __future__ import annotations

from xml.sax.saxutils import escape

import numpy as np

from camtopod.arrays import Floats
from camtopod.export.drawing import LETTERS, RADIUS, ROW, PairLine, draw
from camtopod.export.graph import seconds
from camtopod.records import Topology
from camtopod.visible import visible

MARGIN = 20.0
"""Space around the drawing, pixels."""
STROKE = {True: "#111513", False: "#85908a"}
"""Line colour, by whether the views overlap: black and grey in the thesis."""
DASHES = ' stroke-dasharray="2 8"'
"""Dashes of a weak link and the gaps between them."""
_STYLE = (
    "text{font:13px system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;fill:#1b1f1d;"
    "paint-order:stroke;stroke:#fff;stroke-width:3px;stroke-linejoin:round}"
    ".time{font-size:12px;fill:#4a544f}.title{font-size:15px;font-weight:600}"
)


def to_svg(topology: Topology) -> str:
    """Return the drawing: cameras as circles, overlaps as black lines, unseen paths as grey ones.

    Weak links are dashed; tooltips name the cameras.
    """
    drawing = draw(topology)
    title = _shown(f"{topology.site}, version {topology.version}, {topology.events:,} events")
    keys = ["views overlap", "unseen path, most frequent times; the wider, the more objects"]
    if any(line.weak for line in drawing.lines):
        keys.append("likely, not published yet")

    # The title above, the legend below.
    left, top = drawing.low - (MARGIN, MARGIN + 2 * ROW)
    right, bottom = drawing.high + MARGIN
    width = max(right - left, LETTERS["name"] * max(len(title), len(keys[1])))
    height = bottom - top + ROW * len(keys)
    elements = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}"'
        ' style="max-width:100%;max-height:100%"'
        f' viewBox="{left:.0f} {top:.0f} {width:.0f} {height:.0f}">',
        f"<title>{title}</title><style>{_STYLE}</style>",
        f'<rect x="{left:.0f}" y="{top:.0f}" width="100%" height="100%" fill="#ffffff"/>',
        f'<text class="title" x="{left + MARGIN:.0f}" y="{top + 26:.0f}">{title}</text>',
        *map(_drawn, drawing.lines),
        *(
            _circle(f"{camera.id}, zones: {len(camera.zones)}", drawing.points[camera.id])
            for camera in topology.cameras
        ),
        *(
            f'<text class="{kind}" text-anchor="middle" x="{x:.1f}" y="{y + 4.5:.1f}">'
            f"{_shown(text)}</text>"
            for text, kind, x, y in drawing.texts
        ),
    ]
    for k, key in enumerate(keys):
        x, y = left + MARGIN, bottom + ROW * k
        stroke = _stroke(np.array((x, y)), np.array((x + 28, y)), k == 0, 3.0, weak=k == 2)
        elements.append(f'{stroke}<text class="time" x="{x + 36:.0f}" y="{y + 4:.0f}">{key}</text>')
    return "\n".join([*elements, "</svg>", ""])


def _shown(text: str) -> str:
    """Return text of foreign origin, escaped for XML."""
    return escape(visible(text))


def _drawn(line: PairLine) -> str:
    """Return the line between two cameras, with both directions in its tooltip."""
    tooltip = "; ".join(
        f"{edge.from_} → {edge.to} "
        + ("overlap" if edge.overlapped else seconds(edge.transit.mode))
        for edge in line.edges
    )
    stroke = _stroke(line.start, line.start + line.way, line.overlapped, line.width, line.weak)
    return f"<g><title>{_shown(tooltip)}</title>{stroke}</g>"


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
