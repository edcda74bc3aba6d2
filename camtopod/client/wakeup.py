"""Wake waiting threads (by a condition) and event loops (by a callback) when data arrives."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import TypeVar

T = TypeVar("T")


class ChangeSignal:
    """Change notification: call `notify` after each change; waiters check their condition again."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._listeners: list[Callable[[], None]] = []
        self.closed = False
        """True once no further changes will be announced."""

    def notify(self) -> None:
        """Announce a change. Callable from any thread."""
        with self._condition:
            self._condition.notify_all()
            listeners = list(self._listeners)
        for listener in listeners:
            listener()

    def close(self) -> None:
        """Announce that no more changes will come and release all waiters."""
        self.closed = True
        self.notify()

    def wait_for(self, found: Callable[[], T | None], seconds: float | None = None) -> T | None:
        """Call ``found()`` after each change and return its first result that is not None.

        Returns None when closed or after ``seconds``.
        """
        value: T | None = None

        def over() -> bool:
            nonlocal value
            value = None if self.closed else found()
            return self.closed or value is not None

        if seconds is not None and seconds > threading.TIMEOUT_MAX:  # infinity, for one
            seconds = None
        with self._condition:
            self._condition.wait_for(over, seconds)
        return value

    @contextlib.contextmanager
    def listener_added(self, listener: Callable[[], None]) -> Iterator[None]:
        """Call ``listener`` at each change while the block runs.

        The call comes from the thread that announces the change and must not block.
        """
        with self._condition:
            self._listeners.append(listener)
        try:
            yield
        finally:
            with self._condition:
                self._listeners.remove(listener)
