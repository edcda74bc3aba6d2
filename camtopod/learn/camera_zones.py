"""The zones of all cameras of a learner: learned, refreshed, and begun anew for turned cameras."""

from __future__ import annotations

import numpy as np

from camtopod.event_time import MICROSECONDS
from camtopod.learn.changes import find_move
from camtopod.learn.limits import ZONES_PER_CAMERA_MAX
from camtopod.learn.snapshot import CameraState, LearnerState, RetiredCamera
from camtopod.learn.window import NO_POSITION, Window
from camtopod.learn.zones import (
    ZoneMap,
    ZoneShape,
    cell_sums,
    cells_of,
    find_zones,
    refresh_zones,
)

MOVE_EVENTS = 25
"""New events of a camera after which it is tested again for having been turned."""
ZONES_REFRESH_SHARE = 0.1
"""Share of a camera's events in the window that must be new for its zones to be learned again."""


def find_moved_cameras(state: LearnerState, window: Window) -> None:
    """Test cameras with enough new events for having been turned.

    The events of a turned camera from before the move are forgotten, and its zones get new
    numbers.
    """
    to_test = [
        camera
        for camera, known in enumerate(state.cameras)
        if window.seen[camera] - known.tested_at >= MOVE_EVENTS
    ]
    for camera in to_test:
        # Test the grid cells of the camera's events.
        known = state.cameras[camera]
        known.tested_at = window.seen[camera]
        rows = window.rows_of_camera(camera)
        rows = rows[window.column("px")[rows] != NO_POSITION]
        px, py = (window.column(name)[rows].astype(np.int64) for name in ("px", "py"))
        move = find_move(cells_of(px, py), known.zones.cells)

        # Learn the zones of the new view from the events since the move.
        if move:
            since = float(window.column("t")[rows[move.first]] / MICROSECONDS)
            window.forget_camera(camera, int(rows[move.first]))
            since_move = slice(move.first, None)
            known.zones = find_zones(
                cell_sums(px[since_move], py[since_move]), (), known.zones.next_number
            )
            known.zoned_at = known.tested_at
            known.vanished = ()
            state.moved.append((camera, since, move))


def refresh_camera_zones(state: LearnerState, window: Window, anew: bool = False) -> None:
    """Learn the zones of new cameras, and again those of cameras with enough new events.

    anew: True to learn the zones of all cameras from nothing; they keep their numbers.
    """
    placed = window.has_position()
    px, py = (window.column(name).astype(np.int64) for name in ("px", "py"))
    for camera, rows_of_camera in enumerate(window.rows_of_cameras()):
        events = window.seen[camera]
        rows = rows_of_camera[placed[rows_of_camera]]

        # A new camera, or a retired one that reports again.
        if camera == len(state.cameras):
            retired = state.retired.pop(window.cameras[camera], RetiredCamera())
            zones = find_zones(cell_sums(px[rows], py[rows]), retired.zones, retired.next_number)
            vanished = _vanished(retired.zones, zones)
            state.cameras.append(CameraState(zones, events, vanished, events))
            continue

        # A known camera.
        known = state.cameras[camera]
        if anew or events - known.zoned_at >= ZONES_REFRESH_SHARE * len(rows):
            before = known.zones.zones + known.vanished
            sums = cell_sums(px[rows], py[rows])
            known.zones = (
                find_zones(sums, before, known.zones.next_number)
                if anew
                else refresh_zones(sums, known.zones, known.vanished)
            )
            known.zoned_at = events
            known.vanished = _vanished(before, known.zones)


def _vanished(known: tuple[ZoneShape, ...], now: ZoneMap) -> tuple[ZoneShape, ...]:
    """Return the known zones that are not in the present map, `ZONES_PER_CAMERA_MAX` at most."""
    numbers = {zone.number for zone in now.zones}
    return tuple(zone for zone in known if zone.number not in numbers)[:ZONES_PER_CAMERA_MAX]
