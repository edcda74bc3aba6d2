"""changes"""

from __future__ import annotations

from camtopod.learn.changes.alarms import AlarmLog, AlarmState
from camtopod.learn.changes.camera_moved import Move, find_move
from camtopod.learn.changes.change_points import Change, find_changes, present
from camtopod.learn.changes.silence import Silences, find_silences

__all__ = [
    "AlarmLog",
    "AlarmState",
    "Change",
    "Move",
    "Silences",
    "find_changes",
    "find_move",
    "find_silences",
    "present",
]
