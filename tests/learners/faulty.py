"""A learner process that fails at marked events.

It replaces `camtopod.serve.learner_process.worker`; the track of an event names the failure.
"""

from __future__ import annotations

import os
import signal
import time
from typing import Any

from camtopod.learn.learner import Learner
from camtopod.records import Event
from camtopod.serve.learner_process import worker


class FaultyLearner(Learner):
    """A learner that fails, is killed, crashes or hangs at marked events, and learns all
    others. One fails behind the version that an event has made due.
    """

    _is_receiving = False

    def receive(self, event: Event) -> str:
        match event.track:
            case "fails":
                raise ZeroDivisionError(f"at {event.camera}")
            case "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            case "crashes":
                os.kill(os.getpid(), signal.SIGSEGV)
            case "lasts":
                while True:  # busy, like a fit; not a wait that could be interrupted
                    time.monotonic()
        self._is_receiving = True
        outcome = super().receive(event)
        self._is_receiving = False
        return outcome

    def resume(self) -> None:
        held = self._intake.state.held
        if not self._is_receiving and any(event.track == "fails later" for event in held):
            raise ZeroDivisionError("behind the version that an event has made due")
        super().resume()


def main(*given: Any) -> None:
    worker.main(*given, learner=FaultyLearner)
