"""Work that nobody waits for, beside threads that somebody waits for: a little of it, then a longer
pause.

A thread that answers gives the interpreter away several times an event, and each time one that
works on keeps it for a moment: beside one without pauses fewer events are answered than come.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

WORK_SECONDS = 0.001
"""Then there is a pause ..."""
PAUSE_TIMES = 3.0
"""... so many times as long as the work took, in which what has come meanwhile is answered."""
PAUSE_SECONDS_MAX = 0.05
"""Whoever has not worked for so long was kept from it."""
PARTS_DEEP = 3
"""Parts of parts of parts of a topology or predictor are small: what follows on a zone, a
context.
"""


class Leisure:
    """Call it often while working. ``rest`` is given seconds: `time.sleep` or what ends early when
    all is to end.
    """

    def __init__(
        self, rest: Callable[[float], object], steady: Callable[[], float] = time.monotonic
    ) -> None:
        self._rest, self._steady = rest, steady
        self._since = steady()

    def __call__(self) -> None:
        """A pause, if it is time for one."""
        worked = self._steady() - self._since
        if worked >= WORK_SECONDS:
            self._rest(min(PAUSE_TIMES * worked, PAUSE_SECONDS_MAX))
            self._since = self._steady()


def let_go(wholes: list[object], pause: Callable[[], None]) -> None:
    """Empty the list, and forget part by part what nobody else holds any more. That in one go takes
    a hundredth of a second or two, in which no other thread has a turn.
    """
    for deep in range(PARTS_DEEP):
        parts: list[object] = []
        while wholes:
            one = wholes.pop()
            if deep < PARTS_DEEP - 1 or isinstance(one, list | dict):
                parts += [part for part in gc.get_referents(one) if gc.is_tracked(part)]
            del one
            pause()
        wholes = parts
    while wholes:
        wholes.pop()
        pause()
