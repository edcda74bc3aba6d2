"""Layout and disturbances of a simulated network, fixed before anyone walks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camtopod.arrays import Floats
from camtopod.sim.layout import (
    Layout,
    make_layout,
    with_fire_doors,
    with_one_way,
    with_uneven_paths,
    without_paths,
)
from camtopod.sim.settings import SimSettings

TURNED_RADIANS = (0.7, 2.4)
"""Range of the angle by which a turned camera rotates its zones about the image's centre."""

DirectedPaths = set[tuple[int, int]]
"""Set of directed paths (from zone, to zone)."""


@dataclass(frozen=True)
class Setup:
    """Layout and disturbances of a network.

    closing, opening: directed paths that close and that open during the recording.
    offsets (cameras,) seconds: clock offset of each camera.
    turned: camera index -> (time of turning, seconds after the start; matrix of the turn).
    """

    layout: Layout
    closing: DirectedPaths
    opening: DirectedPaths
    offsets: Floats
    turned: dict[int, tuple[float, Floats]]


def make_setup(settings: SimSettings, rng: np.random.Generator) -> Setup:
    """Return the network of the settings. Raises ValueError for a camera that does not exist."""
    s = settings
    layout = make_layout(s.cameras, rng, s.overlap_share, s.zone_separation, s.zone_stretch)
    for camera in {camera for camera, _, _ in s.lost} | {camera for camera, _ in s.moved}:
        if camera not in layout.cameras:
            known = f"{layout.cameras[0]} to {layout.cameras[-1]}"
            raise ValueError(f"no camera {camera!r} to lose or move; there are {known}")

    # Doors and clocks.
    closing, opening = _doors(layout, s, rng)
    offsets = s.clock_sd * rng.standard_normal(s.cameras)
    later = np.random.default_rng(
        (s.seed, 4)
    )  # a stream of its own: older settings keep their networks
    off = later.permutation(s.cameras) < round(s.clock_share * s.cameras)
    offsets = offsets + np.where(off, later.uniform(-s.clock_max, s.clock_max, s.cameras), 0.0)

    # Turned cameras and changes of the layout.
    turned = {layout.cameras.index(camera): (since, _turn(later)) for camera, since in s.moved}
    if s.fire_doors:
        layout = with_fire_doors(layout, s.fire_doors, later)
    if s.uneven:
        layout = with_uneven_paths(layout, s.uneven, np.random.default_rng((s.seed, 6)))
    if s.one_way:
        layout = with_one_way(layout, s.one_way, np.random.default_rng((s.seed, 7)))
    return Setup(layout if s.linked else without_paths(layout), closing, opening, offsets, turned)


def _doors(
    layout: Layout, settings: SimSettings, rng: np.random.Generator
) -> tuple[DirectedPaths, DirectedPaths]:
    """Return the directed paths that close and those that open: both directions of some unseen
    paths.
    """
    ways = layout.onward
    open_ = np.argwhere((ways.probability > 0) & (ways.metres > 0))
    paths = sorted(
        {(int(min(u, v)), int(max(u, v))) for u, v in ((u, ways.target[u, k]) for u, k in open_)}
    )
    chosen = rng.permutation(len(paths))
    closing, opening = np.split(
        chosen[: settings.doors_closed + settings.doors_opened], [settings.doors_closed]
    )
    return _both(paths, closing.tolist()), _both(paths, opening.tolist())


def _both(paths: list[tuple[int, int]], chosen: list[int]) -> DirectedPaths:
    """Return the chosen paths in both directions."""
    return {way for k in chosen for way in (paths[k], paths[k][::-1])}


def _turn(rng: np.random.Generator) -> Floats:
    """Return the matrix of a random turn, which brings zones nearer to the image's centre."""
    angle = rng.choice((-1.0, 1.0)) * rng.uniform(*TURNED_RADIANS)
    return 0.8 * np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))


def turned(at: Floats, turn: Floats) -> Floats:
    """Return image positions (n, 2) as they are after a camera was turned by a matrix."""
    result: Floats = np.clip(0.5 + (at - 0.5) @ turn.T, 0.0, 1.0)
    return result
