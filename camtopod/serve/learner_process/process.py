"""The daemon's end of the learner's process: started, asked, heard, ended."""

from __future__ import annotations

import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from camtopod.serve.learner_process import messages
from camtopod.serve.learner_process.messages import Answer, Board, Question

PROGRAM = "camtopod.serve.learner_process.start"
END_SECONDS = 5.0
"""For the system to end a process that was killed."""
_LOOK_SECONDS = 0.2
_FOR_THE_DAEMON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Sent to the whole group, by a terminal or systemd; what they ask for is the daemon's to do."""


class LearnerEnded(RuntimeError):
    """The process has ended by itself; ``status`` as `subprocess` gives it, ``at``: the entry it
    was at, 0: none.
    """

    def __init__(self, status: int, at: int) -> None:
        how = f"status {status}" if status >= 0 else f"signal {-status}"
        super().__init__(
            f"the learner's process has ended ({how})"
            + (f" at entry {at} of the journal" if at else "")
        )
        self.status, self.at = status, at


@contextmanager
def _blocked() -> Iterator[None]:
    """What starts in the block never gets these signals."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _FOR_THE_DAEMON)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class LearnerProcess:
    """Runs from the beginning until `close`, which has to be called. One thread asks at a time.

    It is a program of its own and no fork or copy of this one, whatever that is: there are threads
    here, a bus and a database. ``program``: the module to run.
    """

    def __init__(self, program: str = PROGRAM) -> None:
        self._board = Board()
        self._seen = 0
        here = os.pathsep.join(sys.path)  # it finds the same modules as this process
        with _blocked():
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", program, str(self._board.fd)],
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=[self._board.fd],
                env={**os.environ, "PYTHONPATH": here},
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        self._ready = select.poll()
        self._ready.register(self._out, select.POLLIN)
        self._ended = False

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def send(self, question: Question) -> None:
        """Ask, when everything before has been answered. Raises `LearnerEnded`."""
        try:
            messages.send(self._in.fileno(), question)
        except BrokenPipeError:
            raise self._end() from None

    def receive(self, seconds: float) -> Answer | None:
        """What it says, None if that is nothing within ``seconds``. Raises `LearnerEnded`."""
        if not self._ready.poll(1000 * seconds):
            return None
        try:
            return messages.answer(self._out.fileno())
        except EOFError:
            raise self._end() from None

    def ask(self, question: Question, seconds_max: float = math.inf) -> Answer:
        """Ask and wait; after ``seconds_max`` the process is ended. Raises `LearnerEnded`."""
        until = time.monotonic() + seconds_max
        self.send(question)
        while (answer := self.receive(_LOOK_SECONDS)) is None:
            if time.monotonic() > until:
                self.kill()
        return answer

    def check(self) -> None:
        """Raises `LearnerEnded` if it has."""
        if self._process.poll() is not None:
            raise self._end()

    def got_on(self) -> bool:
        """Whether it is at another entry than when this was asked last."""
        before, self._seen = self._seen, self._board.at
        return self._seen != before

    def hurry(self) -> None:
        """It should answer after the entry it is at."""
        self._board.hurry = True

    def kill(self) -> None:
        """End it, whatever it does; a thread that waits for it gets `LearnerEnded`. Any thread."""
        self._process.kill()

    def close(self) -> None:
        """No process and nothing open any more; may be called twice."""
        if not self._ended:
            self._ended = True
            self.kill()
            self._process.wait(END_SECONDS)
            self._in.close()
            self._out.close()
            self._board.close()

    def _end(self) -> LearnerEnded:
        try:
            status = self._process.wait(END_SECONDS)
        except (
            subprocess.TimeoutExpired
        ):  # it has closed its end and lives on, or the system is very slow
            self.kill()
            status = self._process.wait(END_SECONDS)
        return LearnerEnded(status, self._board.at)
