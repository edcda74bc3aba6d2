"""Bounded queue of predictions or matches received from the daemon and not yet read."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from camtopod import codec
from camtopod.client.wakeup import ChangeSignal
from camtopod.records import Match, Prediction
from camtopod.serve.bus import Bus, guard

WAITING_MAX = 1000
"""Answers that may wait to be read; beyond it the oldest are dropped and counted."""
AnswerT = TypeVar("AnswerT", Prediction, Match)


class AnswerQueue(Generic[AnswerT]):
    """Subscription to the daemon's answers until closed: common part of both `Answers` classes."""

    def __init__(
        self, bus: Bus, kind: type[AnswerT], camera: str | None, seconds: float | None
    ) -> None:
        if camera is not None:
            codec.require_camera(camera)
        self._kind: type[AnswerT] = kind
        self._seconds = seconds
        self._answers: deque[AnswerT] = deque(maxlen=WAITING_MAX)
        self._news = ChangeSignal()
        self.dropped = 0
        """Answers dropped because the queue was full."""
        key = f"{kind.__name__.lower()}/{camera or '*'}"
        self._unsubscribe = bus.subscribe(key, self._on_answer)
        guard(self)

    @property
    def closed(self) -> bool:
        """True once no further answers will arrive."""
        return self._news.is_closed

    def close(self) -> None:
        """Unsubscribe and release all waiters. May be called repeatedly."""
        if not self.closed:
            self._news.close()
            self._unsubscribe()

    def _on_answer(self, key: str, payload: bytes) -> None:
        try:
            answer = codec.read(self._kind, payload, pack=True)
        except codec.Rejected:  # of another program than the daemon
            return
        self.dropped += len(self._answers) == self._answers.maxlen
        self._answers.append(answer)
        self._news.notify()

    def _take(self) -> AnswerT | None:
        try:
            return self._answers.popleft()
        except IndexError:
            return None
