"""Wake waiting threads and event loops when data arrives."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

T = TypeVar("T")


class ChangeSignal:
    """Change notification: call `notify` after each change; waiters check their condition again."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[], None]] = []  # whose methods used here are atomic
        self.is_closed = False
        """True once no further changes will be announced."""

    def notify(self) -> None:
        """Announce a change. Callable from any thread."""
        for listener in self._listeners.copy():
            listener()

    def close(self) -> None:
        """Announce that no more changes will come and release all waiters."""
        self.is_closed = True
        self.notify()

    def wait_for(self, search: Callable[[], T | None], seconds: float | None = None) -> T | None:
        """Call ``search()`` after each change and return its first result that is not None.

        Returns None when closed or after ``seconds``.
        """
        deadline = time.monotonic() + (math.inf if seconds is None else seconds)
        change = threading.Event()
        with self.listener_added(change.set):
            while not self.is_closed:
                change.clear()
                if (value := search()) is not None:
                    return value
                seconds_left = deadline - time.monotonic()
                if not change.wait(min(max(seconds_left, 0.0), threading.TIMEOUT_MAX)):
                    break
        return None

    @contextlib.contextmanager
    def listener_added(self, listener: Callable[[], None]) -> Iterator[None]:
        """Call ``listener`` at each change while the block runs.

        The call comes from the thread that announces the change and must not block.
        """
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)
