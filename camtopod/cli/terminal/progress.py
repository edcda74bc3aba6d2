"""Progress of long work on standard error.

On a terminal it is one line that is overwritten; elsewhere nothing, or with ``lines`` a line every
few seconds.
"""

from __future__ import annotations

import contextlib
import math
import sys
import time

SHOW_SECONDS = 0.5
"""Interval between updates on a terminal."""
PIPED_SECONDS = 5.0
"""Interval between lines where there is no terminal."""
_CLEAR = "\r\x1b[K"
"""Control sequence that empties the line."""


class ProgressLine(contextlib.AbstractContextManager["ProgressLine"]):
    """One line, cleared when the block ends; with ``lines`` also without a terminal."""

    def __init__(self, lines: bool = False) -> None:
        self._terminal = sys.stderr.isatty()
        self._interval = math.inf
        if self._terminal:
            self._interval = SHOW_SECONDS
        elif lines:
            self._interval = PIPED_SECONDS
        self._next = time.monotonic() + self._interval

    @property
    def due(self) -> bool:
        """Return True if `show` would print now."""
        return time.monotonic() >= self._next

    def show(self, form: str, *values: object) -> None:
        """Print ``form % values`` unless the last line is too recent; may be called often."""
        if not self.due:
            return
        self._next = time.monotonic() + self._interval
        if self._terminal:
            print(f"{_CLEAR}{form % values}", end="\r", file=sys.stderr, flush=True)
        else:
            print(f"camtopod: {form % values}", file=sys.stderr, flush=True)

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            print(_CLEAR, end="", file=sys.stderr, flush=True)
