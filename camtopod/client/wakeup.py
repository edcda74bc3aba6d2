"""How whoever waits hears that something has come: threads by a condition, an event loop by a
call.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import TypeVar

T = TypeVar("T")


class News:
    """`tell` after each change; `wait_for` looks again at each."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._listeners: list[Callable[[], None]] = []
        self.closed = False
        """Whether there will be no more."""

    def tell(self) -> None:
        """Something has come. Any thread."""
        with self._condition:
            self._condition.notify_all()
            listeners = list(self._listeners)
        for listener in listeners:
            listener()

    def close(self) -> None:
        """There will be no more: whoever waits is let go."""
        self.closed = True
        self.tell()

    def wait_for(self, found: Callable[[], T | None], seconds: float | None = None) -> T | None:
        """What ``found()`` returns as soon as that is something; None when it is closed or after
        ``seconds``.
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
    def heard_by(self, listener: Callable[[], None]) -> Iterator[None]:
        """Call ``listener``, which must not block, at each change while the block runs; from any
        thread.
        """
        with self._condition:
            self._listeners.append(listener)
        try:
            yield
        finally:
            with self._condition:
                self._listeners.remove(listener)
