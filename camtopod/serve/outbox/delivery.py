"""Delivery of one camera's events from its spool to the daemon of a site, one request at a time.

The daemon's answers decide: they tell how far it has stored each boot, and the queue continues
after that number, forwards or backwards. The next request is a hello at the start, when a daemon
appears, and after a request without an answer; otherwise a batch. This is a state machine without
I/O, clock, or threads.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

from camtopod.serve.outbox.site_queue import SiteQueue
from camtopod.serve.requests import ANSWER_SECONDS_MAX, Answer, Batch, Hello

RETRY_SECONDS = 2.0
"""Wait after a request that was of no use; it doubles with each one in a row."""
RETRY_SECONDS_MAX = 30.0
"""Longest such wait, and the wait after the reason ``cameras``."""
SLOW_SECONDS = 5.0
"""An answer that took longer is followed by a request at once, even by an empty one.

The daemon waits for a camera's next request that long before it goes on without the camera.
"""
UNANSWERED_MAX = 3
"""Requests in a row without an answer, after which a visible daemon is not expected to answer."""


class Delivery:
    """The requests for the events of ``camera`` in ``queue``; times are monotonic seconds.

    draw_number: returns a text that was never returned before, for a hello or a boot
        (`camtopod.serve.requests.Number`).
    """

    def __init__(self, camera: str, queue: SiteQueue, draw_number: Callable[[], str]) -> None:
        self.camera = camera
        self.late = 0
        """Number of this process's events that are older than those learned last."""
        self.refusals = 0
        """Number of this process's events that the daemon has refused."""
        self.no_room = ""
        """Why the daemon does not take this camera, which is one too many; "" if it does."""
        self.reason = ""
        """Why the daemon took nothing of the last request, in its words; "" if it did."""
        self._queue = queue
        self._draw_number = draw_number
        self._number = ""
        self._sent_at = 0.0
        self._batch_max = 1
        self._tops: Counter[str] = Counter()  # boot that this process numbers -> highest one sent
        self.on_daemon(-math.inf)

    def on_daemon(self, now: float) -> None:
        """A daemon has appeared: end the request under way and the waiting."""
        self._request: Hello | Batch | None = None
        self._empty: tuple[str, int] | None = None  # boot and number of an empty batch to be sent
        self._has_greeting = False
        self.failures = 0
        """Number of requests in a row that ended without an answer."""
        self._retry_at = now
        self._retry_seconds = RETRY_SECONDS

    def next_request(self, now: float) -> Hello | Batch | None:
        """Return the request to send now; None if there is none. Its answer is `on_answer`'s."""
        if self._request is not None and now >= self._sent_at + ANSWER_SECONDS_MAX:
            self.on_answer(self._request, None, now)
        if self._request is not None or now < self._retry_at:
            return None
        if self._has_greeting:
            self._request = self._next_batch()
        else:
            self._number = self._draw_number()
            self._request = Hello(self._number, self._queue.boots(self.camera))
        self._sent_at = now
        return self._request

    def on_answer(self, request: Hello | Batch, answer: Answer | None, now: float) -> None:
        """Take the answer to a request; None if it ended without one. A late one is ignored."""
        if request is not self._request:
            return
        slow = now - self._sent_at > SLOW_SECONDS
        self._request = None
        if answer is None:
            self.failures += 1
            self._has_greeting = False
            self._wait(now)
            return
        self.failures = 0

        # Apply the answer.
        self._batch_max = answer.batch
        if isinstance(request, Batch) and self._queue.is_own(self.camera, request.boot):
            # Before who waits for the marks looks at it.
            self.late += answer.late
            self.refusals += answer.refused
        progress = self._note_marks(request, answer)
        if progress:
            self._retry_seconds = RETRY_SECONDS
        self.reason = answer.detail
        self.no_room = ""
        if answer.reason == "cameras":
            self.no_room = answer.detail or "the daemon has as many cameras as cameras_max allows"

        # Choose the next request and its time.
        self._empty = None
        if isinstance(request, Hello):
            self._has_greeting = not answer.reason
            useful = self._has_greeting
        elif answer.reason == "held":
            self._empty = request.boot, max([request.after, *(seq for seq, _ in request.events)])
            useful = slow
        else:
            self._has_greeting = answer.reason not in ("hello", "cameras")
            useful = not answer.reason and (progress or not request.events)
            if useful and slow:
                self._empty = request.boot, self._queue.mark(self.camera, request.boot)
        if not useful:
            self._wait(now)

    @property
    def deadline(self) -> float:
        """When to call `next_request` though nothing happens; infinite if not at all."""
        if self._request is not None:
            return self._sent_at + ANSWER_SECONDS_MAX
        if not self._has_greeting or self._empty or self._queue.waiting(self.camera):
            return self._retry_at
        return math.inf

    def _next_batch(self) -> Batch | None:
        """Return the batch to send: the next events, or an empty one; None if none is due."""
        if self._empty is not None:
            return Batch(self._number, *self._empty, [], self._queue.waiting(self.camera))
        batch = self._queue.next_batch(self.camera, self._batch_max)
        if batch is None:
            return None
        boot, events = batch
        if boot == self._queue.boot(self.camera):
            self._tops[boot] = max(events[-1][0], self._tops[boot])
        after = min(self._queue.mark(self.camera, boot), events[0][0] - 1)
        remainder = self._queue.waiting(self.camera) - len(events)
        return Batch(self._number, boot, after, events, max(0, remainder))

    def _note_marks(self, request: Hello | Batch, answer: Answer) -> bool:
        """Move the marks to where the answer says; return True if that of the request has moved."""
        boot = request.boot if isinstance(request, Batch) else self._queue.boot(self.camera)
        before = self._queue.boot(self.camera), self._queue.mark(self.camera, boot)
        for name, have in answer.have.items():
            if name == self._queue.boot(self.camera) and have > self._tops[name]:
                # A machine that was set back has given these numbers before.
                self._queue.begin_boot(self.camera, self._draw_number())
            self._queue.have(self.camera, name, have)
        return before != (self._queue.boot(self.camera), self._queue.mark(self.camera, boot))

    def _wait(self, now: float) -> None:
        """Wait until the next request."""
        seconds = RETRY_SECONDS_MAX if self.no_room else self._retry_seconds
        self._retry_at = now + seconds
        self._retry_seconds = min(RETRY_SECONDS_MAX, 2 * self._retry_seconds)
