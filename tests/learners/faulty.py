"""A learner process that fails at marked events.

It replaces `camtopod.serve.learner_process.worker`; the track of an event names the failure.
"""

from __future__ import annotations

import os
import signal
import time

from camtopod.learn.learner import Learner
from camtopod.records import Event
from camtopod.serve.learner_process.worker import main


class FaultyLearner(Learner):
    """A learner that fails, is killed, crashes, prints or hangs at marked events, and learns all
    others.
    """

    def receive(self, event: Event) -> str:
        match event.track:
            case "fails":
                raise ZeroDivisionError(f"at {event.camera}")
            case "exhausted":
                raise MemoryError(f"at {event.camera}")
            case "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            case "crashes":
                os.kill(os.getpid(), signal.SIGSEGV)
            case "prints":
                print("a stray line of a library", flush=True)
            case "lasts":
                while True:  # busy, like a fit; not a wait that could be interrupted
                    time.monotonic()
        return super().receive(event)


if __name__ == "__main__":
    main(FaultyLearner)
