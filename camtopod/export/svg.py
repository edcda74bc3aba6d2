"""Drawing of the camera network as SVG, for any browser."""

from __future__ import annotations

from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from camtopod.export.graph import Edge, edges, seconds
from camtopod.records import Topology
from camtopod.visible import visible

NODE_WIDTH, NODE_HEIGHT = 110.0, 40.0
"""Size of a camera's box, in units of the drawing."""
PART_ROWS = 64
"""Cameras whose repulsion is computed at a time, to limit memory."""
DISTANCE_MIN = 1e-4
"""Smallest distance of two cameras in the layout (share of its width); avoids division by 0."""
STROKE = {True: "#111111", False: "#9a9a9a"}
"""Line colour, by whether the views overlap: black and grey in the thesis."""


def to_svg(topology: Topology) -> str:
    """Return the drawing: cameras as boxes, overlaps as black edges, unseen paths as grey ones.

    Labels are the modes of the transit times in both directions.
    """
    names = [camera.id for camera in topology.cameras]
    found = edges(topology)

    # One line for both directions of a pair.
    both: dict[tuple[str, str], list[Edge]] = {}
    for edge in found:
        both.setdefault((min(edge.from_, edge.to), max(edge.from_, edge.to)), []).append(edge)

    # Positions.
    size = 230.0 * max(1.5, len(names) ** 0.5)
    at = spring_layout(names, sorted(both)) * size
    place = {name: (float(x) + 90, float(y) + 70) for name, (x, y) in zip(names, at, strict=True)}
    width, height = size + 180, size + 130

    # Frame, edges, then nodes on top.
    title = f"{topology.site}, version {topology.version}, {topology.events} events"
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif"'
        f' viewBox="0 0 {width:.0f} {height:.0f}">',
        f"<title>{_shown(title)}</title>",
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>',
        f'<text x="16" y="24" font-size="14" fill="#333333">{_shown(title)}</text>',
        _legend(height),
    ]
    parts += [
        _edge(place[a], place[b], ways)
        for (a, b), ways in sorted(both.items(), key=lambda item: item[0])
    ]
    parts += [_node(camera.id, len(camera.zones), place[camera.id]) for camera in topology.cameras]
    return "\n".join([*parts, "</svg>", ""])


def _shown(text: str) -> str:
    """Return text of foreign origin, escaped for XML."""
    return escape(visible(text))


def spring_layout(
    names: list[str], joined: list[tuple[str, str]], rounds: int = 200
) -> NDArray[np.float64]:
    """Return positions (n, 2) in the unit square: edges pull, all cameras repel each other.

    Fruchterman & Reingold 1991.
    """
    # Start on a circle.
    n = len(names)
    angle = 2 * np.pi * np.arange(n) / max(n, 1)
    at = (
        0.5
        + 0.5 * np.column_stack([np.cos(angle), np.sin(angle)])
        + 0.01 * np.sin(7.0 * angle + 1)[:, None]
    )

    # Move by the forces, with steps that shrink.
    index = {name: k for k, name in enumerate(names)}
    ends = np.array([(index[a], index[b]) for a, b in joined], np.intp).reshape(-1, 2)
    one, other = np.concatenate([ends, ends[:, ::-1]]).T
    ideal = 1.0 / max(n, 1) ** 0.5
    for step in np.linspace(0.1, 0.001, rounds):
        move = _pushes(at, ideal)
        apart = at[one] - at[other]
        np.subtract.at(move, one, apart * np.linalg.norm(apart, axis=1, keepdims=True) / ideal)
        at += move * np.minimum(1.0, step / np.maximum(np.linalg.norm(move, axis=1), 1e-9))[:, None]

    # Scale to the unit square.
    span = np.ptp(at, axis=0) if n else np.ones(2)
    result: NDArray[np.float64] = (
        (at - at.min(0, initial=np.inf)) / np.maximum(span, 1e-9) if n > 1 else at
    )
    return result


def _pushes(at: NDArray[np.float64], ideal: float) -> NDArray[np.float64]:
    """Return the sum of repulsions on each camera, (n, 2), computed in parts of `PART_ROWS`."""
    total = np.empty_like(at)
    for first in range(0, len(at), PART_ROWS):
        rows = slice(first, first + PART_ROWS)
        x, y = (at[rows, axis, None] - at[:, axis] for axis in (0, 1))
        force = ideal**2 / np.maximum(x * x + y * y, DISTANCE_MIN**2)
        total[rows, 0], total[rows, 1] = (x * force).sum(1), (y * force).sum(1)
    return total


def _node(name: str, zones: int, at: tuple[float, float]) -> str:
    """Return the box of a camera."""
    x, y = at
    corner = f'x="{x - NODE_WIDTH / 2:.1f}" y="{y - NODE_HEIGHT / 2:.1f}"'
    size = f'width="{NODE_WIDTH:.0f}" height="{NODE_HEIGHT:.0f}"'
    count = f"{zones} zone" if zones == 1 else f"{zones} zones"
    shown = name if len(name) <= 14 else name[:13] + "…"
    return (
        f'<g text-anchor="middle"><title>{_shown(name)}</title>'
        f'<rect {corner} {size} rx="8" fill="#eef3f8" stroke="#44617b"/>'
        f'<text x="{x:.1f}" y="{y - 2:.1f}" font-size="13" fill="#111111">{_shown(shown)}</text>'
        f'<text x="{x:.1f}" y="{y + 13:.1f}" font-size="10" fill="#666666">{count}</text></g>'
    )


def _edge(a: tuple[float, float], b: tuple[float, float], ways: list[Edge]) -> str:
    """Return the line between two cameras, with the transit times of both directions."""
    overlapped = any(edge.overlapped for edge in ways)
    thick = 1.5 + 3 * max(edge.probability for edge in ways)
    label = " / ".join(f"{edge.from_} → {edge.to} {seconds(edge.transit.mode)}" for edge in ways)
    times = " / ".join(seconds(edge.transit.mode) for edge in ways)
    x, y = (a[0] + b[0]) / 2, (a[1] + b[1]) / 2
    return (
        f"<g><title>{_shown(label)}</title>"
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"'
        f' stroke="{STROKE[overlapped]}" stroke-width="{thick:.1f}"/>'
        f'<text x="{x:.1f}" y="{y - 5:.1f}" font-size="11" text-anchor="middle" fill="#222222"'
        f' stroke="#ffffff" stroke-width="3" paint-order="stroke">{times}</text></g>'
    )


def _legend(height: float) -> str:
    """Return the legend."""
    y = height - 18
    return (
        f'<g font-size="11" fill="#333333"><line x1="16" y1="{y:.0f}" x2="44" y2="{y:.0f}"'
        f' stroke="{STROKE[True]}" stroke-width="3"/>'
        f'<text x="50" y="{y + 4:.0f}">views overlap</text>'
        f'<line x1="140" y1="{y:.0f}" x2="168" y2="{y:.0f}"'
        f' stroke="{STROKE[False]}" stroke-width="3"/>'
        f'<text x="174" y="{y + 4:.0f}">unseen path; most frequent transit time</text></g>'
    )
