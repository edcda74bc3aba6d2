"""Picture of the demo: the true and the learned map, and the learned zones in each view."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from camtopod.arrays import Floats
from camtopod.records import Link, Topology
from camtopod.sim.floor import Plan, Walk
from camtopod.sim.rendering import Colour, Picture, busy_scene, floor_picture, on_plan
from camtopod.sim.scoring import match_zones
from camtopod.sim.truth import TrueLink, Truth
from camtopod.topology import camera_of

MAP_WIDTH = 776
"""Width of each map, pixels."""
THUMB_WIDTH = 260
"""Width of a camera's picture, pixels."""
GAP = 16
"""Space between the parts, and margin of a camera's picture, pixels."""
LINE = 24
"""Height of a line of text, pixels."""
BEND = 0.2
"""How far a link's middle is above the straight line, as a share of its width."""
INK: Colour = (40, 40, 40)
PAPER: Colour = (250, 250, 250)
GREY: Colour = (150, 150, 150)
NODE: Colour = (190, 120, 40)
FOUND: Colour = (70, 160, 60)
FALSE: Colour = (40, 60, 210)
LEGEND = "black: views overlap, grey: unseen path; seconds left to right / right to left"
ZONES_LEGEND = (
    "ellipses: learned zones, two standard deviations; green: a true zone; diamonds: true centres"
)
Times = dict[tuple[str, str], tuple[bool, float]]
"""(from camera, to camera) -> (True if the views overlap, mode of the transit times in seconds)."""


def write_map(
    path: Path,
    plan: Plan,
    walks: list[Walk],
    truth: Truth,
    topology: Topology,
    notes: Sequence[str],
) -> None:
    """Write the picture as PNG; ``notes`` are lines of text below it. Raises OSError."""
    # The two maps.
    true_times = camera_times(truth.links)
    learned_times = camera_times(topology.links)
    maps = [
        _titled(_map(plan, times, true_times), f"{title} map ({LEGEND})")
        for title, times in (("true", true_times), ("learned", learned_times))
    ]

    # The cameras' pictures with learned zones.
    found = set(match_zones(topology.zones, truth.zones).values())
    views = []
    for view in plan.views:
        seen = busy_scene(plan, view, walks)
        height = THUMB_WIDTH * seen.shape[0] // seen.shape[1]
        seen = cv2.resize(seen, (THUMB_WIDTH, height), interpolation=cv2.INTER_CUBIC)
        seen = cv2.copyMakeBorder(seen, GAP, GAP, GAP, GAP, cv2.BORDER_CONSTANT, value=PAPER)
        _zones(seen, view.camera, topology, truth, found)
        views.append(_titled(seen, f"{view.camera}: learned zones"))

    # Both above each other, and the notes.
    rows = [np.hstack(maps), np.hstack(views)]
    width = max(row.shape[1] for row in rows)
    text = np.full((LINE * (len(notes) + 2), width, 3), PAPER, np.uint8)
    for k, note in enumerate([ZONES_LEGEND, *notes], 1):
        _text(text, note, np.array((GAP, k * LINE)), INK)
    padded = [
        cv2.copyMakeBorder(row, 0, 0, 0, width - row.shape[1], cv2.BORDER_CONSTANT, value=PAPER)
        for row in rows
    ]
    if not cv2.imwrite(str(path), np.vstack([*padded, text])):
        raise OSError(f"cannot write the picture {path}")


def camera_times(links: Iterable[Link | TrueLink]) -> Times:
    """Return, for each direction between two cameras, relation and mode of the link walked most."""
    result: Times = {}
    for link in sorted(links, key=lambda link: link.transitions):
        ends = camera_of(link.from_), camera_of(link.to)
        if link.relation != "visible" and ends[0] != ends[1]:
            result[ends] = link.relation == "overlapped", link.transit.mode
    return result


def _titled(picture: Picture, title: str) -> Picture:
    """Return a picture with a title above it and space at its sides."""
    framed = cv2.copyMakeBorder(
        picture, 2 * LINE, 0, GAP // 2, GAP // 2, cv2.BORDER_CONSTANT, value=PAPER
    )
    _text(framed, title, np.array((GAP / 2, LINE + GAP / 2)), INK)
    return framed


def _map(plan: Plan, times: Times, true_times: Times) -> Picture:
    """Return the floor plan with views, cameras and links; a false link has a red label."""
    # The floor, faded, and the footprints of the views.
    floor = floor_picture(plan)
    zoom = MAP_WIDTH / floor.shape[1]
    floor = cv2.resize(floor, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
    picture = cv2.addWeighted(floor, 0.5, np.full_like(floor, 255), 0.5, 0)
    for view in plan.views:
        outline = np.rint(zoom * on_plan(plan, view.footprint())).astype(np.int32)
        cv2.polylines(picture, [outline], True, NODE, 2, cv2.LINE_AA)

    # Links, then cameras and labels.
    place = {view.camera: zoom * on_plan(plan, np.array(view.target)) for view in plan.views}
    labels = []
    for pair in sorted({(min(ends), max(ends)) for ends in times}):
        a, b = sorted(pair, key=lambda name: tuple(place[name]))
        ways = [times.get((a, b)), times.get((b, a))]
        line = _curve(place[a], place[b])
        dots = [np.rint(line * 16).astype(np.int32)]
        colour = INK if any(way[0] for way in ways if way) else GREY
        cv2.polylines(picture, dots, False, PAPER, 9, cv2.LINE_AA, 4)
        cv2.polylines(picture, dots, False, colour, 5, cv2.LINE_AA, 4)
        text = " / ".join(f"{way[1]:.1f}" if way else "-" for way in ways)
        is_true = (a, b) in true_times or (b, a) in true_times
        labels.append((line[len(line) // 2] - np.array((0, 10)), text, INK if is_true else FALSE))
    for name, at in place.items():
        cv2.circle(picture, np.rint(at).astype(int).tolist(), 11, NODE, -1, cv2.LINE_AA)
        labels.append((at + np.array((0, 32)), name, INK))
    for at, text, colour in labels:
        _text(picture, text, at, colour, centred=True)
    return picture


def _curve(a: Floats, b: Floats) -> Floats:
    """Return a line from a to b, (n, 2), bent upwards where it runs from left to right."""
    middle = (a + b) / 2 - np.array((0.0, 2 * BEND * abs(b[0] - a[0])))
    s = np.linspace(0, 1, 41)[:, None]
    result: Floats = (1 - s) ** 2 * a + 2 * s * (1 - s) * middle + s**2 * b
    return result


def _zones(
    picture: Picture, camera: str, topology: Topology, truth: Truth, found: set[str]
) -> None:
    """Draw learned zones as ellipses, green if true, and true centres as diamonds."""
    size = np.array((picture.shape[1], picture.shape[0])) - 2 * GAP
    for true in truth.zones:
        if true.camera == camera:
            at = np.rint(GAP + np.array((true.x, true.y), float) * size).astype(int).tolist()
            cv2.drawMarker(picture, at, INK, cv2.MARKER_DIAMOND, 9, 1, cv2.LINE_AA)
    for zone in topology.zones:
        if zone.camera == camera:
            centre = GAP + np.array((zone.x, zone.y), float) * size
            values, axes = np.linalg.eigh(np.diag(size) @ np.array(zone.cov) @ np.diag(size))
            axis_lengths = np.maximum(4 * np.sqrt(np.maximum(values, 0)), 12)[::-1]
            angle = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
            colour = FOUND if zone.id in found else FALSE
            cv2.ellipse(
                picture, (centre.tolist(), axis_lengths.tolist(), angle), colour, 2, cv2.LINE_AA
            )
            inwards = GAP + size / 2 - centre
            number = centre + 24 * inwards / max(float(np.linalg.norm(inwards)), 1.0)
            _text(picture, zone.id.rpartition("/")[2], number + np.array((0, 6)), colour, True)


def _text(picture: Picture, text: str, at: Floats, colour: Colour, centred: bool = False) -> None:
    """Write ``text`` on a light ground; ``at`` is its left end, or its middle if ``centred``."""
    size, _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 0.5, 1)
    x, y = np.rint(at - np.array((size[0] / 2 * centred, 0.0))).astype(int).tolist()
    cv2.rectangle(picture, (x - 2, y - size[1] - 2), (x + size[0] + 2, y + 4), PAPER, -1)
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_DUPLEX, 0.5, colour, 1, cv2.LINE_AA)
