"""window"""

from __future__ import annotations

from camtopod.learn.window.reorder_buffer import EVENTS_PER_SECOND_MAX, Intake, IntakeState
from camtopod.learn.window.sliding_window import GONE, Window, WindowState, cells_of

__all__ = [
    "EVENTS_PER_SECOND_MAX",
    "GONE",
    "Intake",
    "IntakeState",
    "Window",
    "WindowState",
    "cells_of",
]
