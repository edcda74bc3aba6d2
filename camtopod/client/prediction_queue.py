"""The daemon's predictions that have come and wait to be read."""

from __future__ import annotations

import re
from collections import deque

from camtopod import codec
from camtopod.client.wakeup import News
from camtopod.records import CAMERA_PATTERN, Prediction
from camtopod.serve.bus import Bus

WAITING_MAX = 1000
"""Predictions that wait; of more the oldest are dropped, and counted."""


class Inbox:
    """Subscribed until closed: what `Predictions` and its asyncio twin have in common."""

    def __init__(
        self, bus: Bus, camera: str | None, seconds: float | None, waiting_max: int
    ) -> None:
        if camera is not None and not re.match(CAMERA_PATTERN, camera):
            raise ValueError(f"camera {camera!r}: 1 to 64 of the characters A-Z a-z 0-9 _ . -")
        if waiting_max < 1:
            raise ValueError(f"waiting_max {waiting_max}: at least 1, or nothing can be read")
        self._seconds = seconds
        self._waiting: deque[Prediction] = deque(maxlen=waiting_max)
        self._news = News()
        self.dropped = 0
        """Predictions that did not find room because nobody read for too long."""
        self.unreadable = 0
        """Messages that were no predictions."""
        self._unsubscribe = bus.subscribe(f"prediction/{camera or '*'}", self._on_prediction)

    @property
    def closed(self) -> bool:
        """Whether there will be no more."""
        return self._news.closed

    def close(self) -> None:
        """Unsubscribe; whoever waits is let go. May be called twice."""
        if not self.closed:
            self._news.close()
            self._unsubscribe()

    def _on_prediction(self, key: str, payload: bytes) -> None:
        try:
            prediction = codec.read(Prediction, payload, pack=True)
        except codec.Rejected:
            self.unreadable += 1
            return
        self.dropped += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(prediction)
        self._news.tell()

    def _take(self) -> Prediction | None:
        try:
            return self._waiting.popleft()
        except IndexError:
            return None
