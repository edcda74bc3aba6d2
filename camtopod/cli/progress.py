"""How far long work has come: one line on standard error that is written over, and only where that is a terminal."""

from __future__ import annotations

import sys
import time

SHOW_SECONDS = 0.5
_CLEAR = "\r\x1b[K"


class Progress:
    """The line is gone when the block ends."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._next = time.monotonic() + SHOW_SECONDS

    def show(self, form: str, *values: object) -> None:
        """Say ``form % values`` if it is a terminal and the last time was a while ago; may be called often."""
        if not self._terminal or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + SHOW_SECONDS
        print(f"{_CLEAR}{form % values}", end="\r", file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            print(_CLEAR, end="", file=sys.stderr, flush=True)
