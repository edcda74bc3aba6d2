"""Changes of the site within the window, and the alarms that report them.

Reading order: `change_points` finds links that opened, closed or changed their share of the
departures. `silence` finds cameras that report nothing for too long. `camera_moved` finds cameras
that were turned. `alarms` reports each of these changes once, in the first version that shows it.
"""

from __future__ import annotations

from camtopod.learn.changes.alarms import AlarmLog, AlarmState
from camtopod.learn.changes.camera_moved import Move, find_move
from camtopod.learn.changes.change_points import Change, find_changes, present
from camtopod.learn.changes.silence import CameraSilences, find_silences

__all__ = [
    "AlarmLog",
    "AlarmState",
    "CameraSilences",
    "Change",
    "Move",
    "find_changes",
    "find_move",
    "find_silences",
    "present",
]
