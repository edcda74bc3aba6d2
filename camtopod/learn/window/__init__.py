"""From incoming events to a sliding window of them, ordered by time.

Reading order: `reorder_buffer` drops duplicates and late events and releases the others in
canonical order as the watermark passes them; `sliding_window` stores the released events by column,
pairs entries with exits to passages and sums positions per grid cell.
"""

from __future__ import annotations

from camtopod.learn.window.reorder_buffer import (
    EVENTS_PER_SECOND_MAX,
    ReorderBuffer,
    ReorderBufferState,
)
from camtopod.learn.window.sliding_window import FORGOTTEN, Window, WindowState, cells_of

__all__ = [
    "EVENTS_PER_SECOND_MAX",
    "FORGOTTEN",
    "ReorderBuffer",
    "ReorderBufferState",
    "Window",
    "WindowState",
    "cells_of",
]
