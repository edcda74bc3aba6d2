"""The zones of all cameras of a learner: learned, refreshed, and begun anew for turned cameras."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Longs
from camtopod.event_time import MICROSECONDS, utc_text
from camtopod.learn.changes import News, find_moves
from camtopod.learn.limits import ZONES_PER_CAMERA_MAX
from camtopod.learn.snapshot import LearnedCamera, LearnerState, RetiredCamera
from camtopod.learn.window import NONE, Window
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
        for camera, camera_state in enumerate(state.cameras)
        if window.seen[camera] - camera_state.tested_at >= MOVE_EVENTS
    ]
    cells = []
    for camera in to_test:
        state.cameras[camera].tested_at = window.seen[camera]
        _, px, py = _placed(window, camera)
        cells.append(cells_of(px, py))

    # Learn the zones of a new view from the events since the move.
    moves = find_moves(cells, [state.cameras[camera].zones.cells for camera in to_test])
    for camera, move in zip(to_test, moves, strict=True):
        if move:
            camera_state = state.cameras[camera]
            rows, px, py = (column[move.first :] for column in _placed(window, camera))
            since = float(window.column("t")[rows[0]] / MICROSECONDS)
            window.forget_camera(camera, int(rows[0]))
            camera_state.zones = find_zones(cell_sums(px, py), (), camera_state.zones.next_number)
            camera_state.zoned_at = camera_state.tested_at
            camera_state.vanished = ()
            state.moved.append((camera, since, move))


def moved_news(state: LearnerState, cameras: list[str]) -> list[News]:
    """Return the alarms for the cameras turned since the last version, ``state.moved``."""
    return [
        (
            "camera_moved",
            cameras[camera],
            f"{move.outside:.2f} of {move.events} events outside its zones since {utc_text(since)}",
        )
        for camera, since, move in state.moved
    ]


def refresh_camera_zones(state: LearnerState, window: Window, anew: bool = False) -> None:
    """Learn the zones of new cameras, and again those of cameras with enough new events.

    anew: True to learn the zones of all cameras from nothing; they keep their numbers.
    """
    for camera, events in enumerate(window.seen):
        _, px, py = _placed(window, camera)

        # A new camera, or a retired one that reports again.
        if camera == len(state.cameras):
            retired_camera = state.retired.pop(window.cameras[camera], RetiredCamera())
            zones = find_zones(cell_sums(px, py), retired_camera.zones, retired_camera.next_number)
            vanished_zones = _vanished(retired_camera.zones, zones)
            state.cameras.append(LearnedCamera(zones, events, vanished_zones, events))
            continue

        # A known camera.
        camera_state = state.cameras[camera]
        if anew or events - camera_state.zoned_at >= ZONES_REFRESH_SHARE * len(px):
            before = camera_state.zones.zones + camera_state.vanished
            sums = cell_sums(px, py)
            camera_state.zones = (
                find_zones(sums, before, camera_state.zones.next_number)
                if anew
                else refresh_zones(sums, camera_state.zones, camera_state.vanished)
            )
            camera_state.zoned_at = events
            camera_state.vanished = _vanished(before, camera_state.zones)


def _placed(window: Window, camera: int) -> tuple[Longs, Longs, Longs]:
    """Return row and position (x, y) of each of a camera's events that have one, oldest first."""
    rows = window.rows_of_camera(camera)
    px, py = (window.column(name)[rows].astype(np.int64) for name in ("px", "py"))
    has_position = px != NONE
    return rows[has_position], px[has_position], py[has_position]


def _vanished(zones_before: tuple[ZoneShape, ...], now: ZoneMap) -> tuple[ZoneShape, ...]:
    """Return the known zones that are not in the present map, `ZONES_PER_CAMERA_MAX` at most."""
    numbers = {zone.number for zone in now.zones}
    return tuple(zone for zone in zones_before if zone.number not in numbers)[:ZONES_PER_CAMERA_MAX]
