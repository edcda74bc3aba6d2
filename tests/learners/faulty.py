"""In place of `camtopod.serve.learner_process.worker`: a learner to which an event does what its
track says.
"""

from __future__ import annotations

import os
import signal
import time

from camtopod.learn.learner import Learner
from camtopod.records import Event
from camtopod.serve.learner_process.worker import main


class FaultyLearner(Learner):
    """Fails, is killed, crashes, prints or takes very long; anything else it learns."""

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
                print("a library's word on standard output", flush=True)
            case "lasts":
                while True:  # as a fit does, and no wait that something could end
                    time.monotonic()
        return super().receive(event)


if __name__ == "__main__":
    main(FaultyLearner)
