"""Picture of the demo: the true and the learned map."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from camtopod.arrays import Floats
from camtopod.records import Link, Topology
from camtopod.sim.floor import Plan
from camtopod.sim.rendering import Colour, Picture, floor_picture, on_plan
from camtopod.sim.truth import TrueLink, Truth
from camtopod.topology import camera_of

MAP_WIDTH = 776
"""Width of each map, pixels."""
GAP = 16
"""Space beside each map, pixels."""
LINE = 24
"""Height of a line of text, pixels."""
BEND = 0.2
"""How far a link's middle is above the straight line, as a share of its width."""
INK: Colour = (40, 40, 40)
PAPER: Colour = (250, 250, 250)
GREY: Colour = (150, 150, 150)
NODE: Colour = (190, 120, 40)
FALSE: Colour = (40, 60, 210)
LEGEND = "black: views overlap, grey: unseen path; seconds left to right / right to left"
Times = dict[tuple[str, str], tuple[bool, float]]
"""(from camera, to camera) -> (True if the views overlap, mode of the transit times in seconds)."""


def write_map(
    path: Path, plan: Plan, truth: Truth, topology: Topology, notes: Sequence[str]
) -> None:
    """Write the picture as PNG; ``notes`` are lines of text below it. Raises OSError."""
    true_times = camera_times(truth.links)
    maps = []
    for title, links in (("true", truth.links), ("learned", topology.links)):
        picture = _map(plan, camera_times(links), true_times)
        frame = cv2.copyMakeBorder(picture, 2 * LINE, 0, GAP, GAP, cv2.BORDER_CONSTANT, value=PAPER)
        _text(frame, f"{title} map ({LEGEND})", np.array((GAP, 1.5 * LINE)))
        maps.append(frame)
    maps_picture = np.hstack(maps)
    below = np.full((LINE * (len(notes) + 2), maps_picture.shape[1], 3), PAPER, np.uint8)
    for k, note in enumerate(notes):
        _text(below, note, np.array((GAP, (k + 1.5) * LINE)))
    if not cv2.imwrite(str(path), np.vstack([maps_picture, below])):
        raise OSError(f"cannot write the picture {path}")


def camera_times(links: Iterable[Link | TrueLink]) -> Times:
    """Return, for each direction between two cameras, relation and mode of the link walked most."""
    result: Times = {}
    for link in sorted(links, key=lambda link: link.transitions):
        ends = camera_of(link.from_), camera_of(link.to)
        if link.relation != "visible" and ends[0] != ends[1]:
            result[ends] = link.relation == "overlapped", link.transit.mode
    return result


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
    s = np.linspace(0, 1, 41)[:, None]
    for pair in sorted({(min(ends), max(ends)) for ends in times}):
        a, b = sorted(pair, key=lambda name: tuple(place[name]))
        ways = [times.get((a, b)), times.get((b, a))]

        # A line that is bent upwards.
        rise = np.array((0.0, 2 * BEND * abs(place[b][0] - place[a][0])))
        middle = (place[a] + place[b]) / 2 - rise
        line = (1 - s) ** 2 * place[a] + 2 * s * (1 - s) * middle + s**2 * place[b]
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
        _text(picture, text, at, colour, is_centred=True)
    return picture


def _text(
    picture: Picture, text: str, at: Floats, colour: Colour = INK, is_centred: bool = False
) -> None:
    """Write ``text`` on a light ground; ``at`` is its left end, or its middle if ``is_centred``."""
    size, _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 0.5, 1)
    x, y = np.rint(at - np.array((size[0] / 2 * is_centred, 0.0))).astype(int).tolist()
    cv2.rectangle(picture, (x - 2, y - size[1] - 2), (x + size[0] + 2, y + 4), PAPER, -1)
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_DUPLEX, 0.5, colour, 1, cv2.LINE_AA)
