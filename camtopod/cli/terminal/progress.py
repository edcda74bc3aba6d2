"""How far long work has come: on a terminal one line of standard error that is written over;
elsewhere nothing, or, of work that is waited for, a line every few seconds.
"""

from __future__ import annotations

import math
import sys
import time

SHOW_SECONDS = 0.5
PIPED_SECONDS = 5.0
_CLEAR = "\r\x1b[K"


class Progress:
    """The line on a terminal is gone when the block ends. ``piped``: say it where there is no
    terminal, too.
    """

    def __init__(self, piped: bool = False) -> None:
        self._terminal = sys.stderr.isatty()
        self._every = SHOW_SECONDS if self._terminal else PIPED_SECONDS if piped else math.inf
        self._began = time.monotonic()
        self._next = self._began + self._every

    @property
    def due(self) -> bool:
        """Whether `show` would say something now."""
        return time.monotonic() >= self._next

    @property
    def seconds(self) -> float:
        """Since the work began."""
        return time.monotonic() - self._began

    def show(self, form: str, *values: object) -> None:
        """Say ``form % values`` if the last time was a while ago; may be called often."""
        if not self.due:
            return
        self._next = time.monotonic() + self._every
        if self._terminal:
            print(f"{_CLEAR}{form % values}", end="\r", file=sys.stderr, flush=True)
        else:
            print(f"camtopod: {form % values}", file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            print(_CLEAR, end="", file=sys.stderr, flush=True)
