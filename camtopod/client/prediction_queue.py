"""Bounded queue of predictions received from the daemon and not yet read."""

from __future__ import annotations

from collections import deque

from camtopod import codec
from camtopod.client.wakeup import ChangeSignal
from camtopod.records import Prediction
from camtopod.serve.bus import Bus, guard

WAITING_MAX = 1000
"""Predictions that may wait to be read; beyond it the oldest are dropped and counted."""


class PredictionQueue:
    """Subscription to predictions until closed: common part of both `Predictions` classes."""

    def __init__(self, bus: Bus, camera: str | None, seconds: float | None) -> None:
        if camera is not None:
            codec.require_camera(camera)
        self._seconds = seconds
        self._waiting: deque[Prediction] = deque(maxlen=WAITING_MAX)
        self._news = ChangeSignal()
        self.dropped = 0
        """Predictions dropped because the queue was full."""
        self._unsubscribe = bus.subscribe(f"prediction/{camera or '*'}", self._on_prediction)
        guard(self)

    @property
    def closed(self) -> bool:
        """True once no further predictions will arrive."""
        return self._news.closed

    def close(self) -> None:
        """Unsubscribe and release all waiters. May be called repeatedly."""
        if not self.closed:
            self._news.close()
            self._unsubscribe()

    def _on_prediction(self, key: str, payload: bytes) -> None:
        try:
            prediction = codec.read(Prediction, payload, pack=True)
        except codec.Rejected:  # of another program than the daemon
            return
        self.dropped += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(prediction)
        self._news.notify()

    def _take(self) -> Prediction | None:
        try:
            return self._waiting.popleft()
        except IndexError:
            return None
