"""Messages of Frigate's topic ``frigate/events``, after its documentation, of simulated objects."""

from __future__ import annotations

import json
from typing import Any

WIDTH, HEIGHT = 1280, 720
PLATE, FACE = "KA-AB 1234", "Jane Doe"


def seen(t: float, left: int, top: int, right: int, bottom: int, **more: Any) -> dict[str, Any]:
    """Return an object's state at ``t``; boxes are in pixels of the detect size."""
    box = [left, top, right, bottom]
    return {
        "id": "1719000000.25-a1b2c3",
        "camera": "yard",
        "frame_time": t,
        "snapshot": {"frame_time": t, "box": box, "attributes": [{"label": "face", "box": box}]},
        "label": "person",
        "sub_label": [FACE, 0.91],
        "recognized_license_plate": [PLATE, 0.9],
        "false_positive": False,
        "start_time": 1719000000.25,
        "end_time": None,
        "score": 0.83,
        "box": box,
        "active": True,
        "stationary": False,
        "motionless_count": 0,
        "position_changes": 1,
        "current_zones": ["drive"],
        "attributes": {"face": 0.8},
        **more,
    }


def message(kind: str, before: dict[str, Any], after: dict[str, Any]) -> bytes:
    return json.dumps({"before": before, "after": after, "type": kind}).encode()


def passage(
    number: int = 0, t: float = 1719000000.25, camera: str = "yard", paths: bool = True
) -> list[bytes]:
    """Return the messages of a passage from left to right in eight seconds.

    Frigate reports its end five seconds after the object left.
    """
    name = {"id": f"{t}-{number:06d}", "camera": camera, "start_time": t}
    way = [[[0.0859, 0.8472], t + 0.8], [[0.5, 0.9], t + 4.0]] if paths else None

    def path(points: int) -> dict[str, Any]:
        return {"path_data": way[:points]} if way is not None else {}

    first = seen(t, 10, 300, 110, 600, false_positive=True, position_changes=0, **path(0), **name)
    sure = seen(t + 0.8, 60, 300, 160, 610, **path(1), **name)
    later = seen(t + 4.0, 600, 300, 680, 648, **path(2), **name)
    gone = seen(t + 8.2, 1180, 300, 1270, 640, **{**path(2), **name, "end_time": t + 13.2})
    return [
        message("new", first, sure),
        message("update", sure, later),
        message("end", later, gone),
    ]


def parked(t: float = 1719000000.25, moved: int = 0, stationary: bool = True) -> list[bytes]:
    """Return the messages of a parked car that is detected and lost again."""
    name = {"id": f"{t}-parked", "label": "car", "start_time": t, "position_changes": moved}
    first = seen(t, 700, 300, 900, 420, **{**name, "false_positive": True, "position_changes": 0})
    sure = seen(t + 1, 700, 300, 901, 420, **name)
    still = seen(t + 60, 700, 300, 900, 421, stationary=stationary, motionless_count=300, **name)
    return [
        message("new", first, sure),
        message("update", sure, still),
        message("end", still, still),
    ]
