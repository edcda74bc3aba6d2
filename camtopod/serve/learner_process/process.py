"""The daemon's handle of the learner's process: start it, ask it, and end it."""

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
from camtopod.serve.learner_process.messages import Answer, Question, SharedStatus

PROGRAM = "camtopod.serve.learner_process.worker"
"""The module that the process runs."""
END_SECONDS = 5.0
"""Time that the system may take to end a process that was killed."""
_LOOK_SECONDS = 0.2
"""Interval of checks while an answer is awaited."""
_FOR_THE_DAEMON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that a terminal or systemd sends to the whole process group, but the daemon handles."""


class LearnerEnded(RuntimeError):
    """The learner's process has ended by itself.

    status: exit status as `subprocess` gives it.
    at: the journal entry it was at; 0: none.
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
    """Block `_FOR_THE_DAEMON`; a process that is started in the block never gets these signals."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _FOR_THE_DAEMON)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class LearnerProcess:
    """The learner's process, from its start until `close`, which has to be called.

    One thread asks at a time. The process is a new program, not a fork of this one, which has
    threads, a session and a database.

    program: the module to run.
    """

    def __init__(self, program: str = PROGRAM) -> None:
        self._board = SharedStatus()
        self._seen = 0

        # Start the process.
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

        # Its two pipes.
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        self._ready = select.poll()
        self._ready.register(self._out, select.POLLIN)
        self._ended = False

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def send(self, question: Question) -> None:
        """Send a question, after everything before has been answered. Raises `LearnerEnded`."""
        try:
            messages.send(self._in.fileno(), question)
        except BrokenPipeError:
            raise self._end() from None

    def receive(self, seconds: float) -> Answer | None:
        """Return the next answer; None if ``seconds`` pass without one. Raises `LearnerEnded`."""
        if not self._ready.poll(1000 * seconds):
            return None
        try:
            return messages.read_answer(self._out.fileno())
        except EOFError:
            raise self._end() from None

    def ask(self, question: Question, seconds_max: float = math.inf) -> Answer:
        """Send a question and return its answer. Raises `LearnerEnded`.

        The process is killed after ``seconds_max``.
        """
        until = time.monotonic() + seconds_max
        self.send(question)
        while (answer := self.receive(_LOOK_SECONDS)) is None:
            if time.monotonic() > until:
                self.kill()
        return answer

    def check(self) -> None:
        """Raise `LearnerEnded` if the process has ended."""
        if self._process.poll() is not None:
            raise self._end()

    def has_progressed(self) -> bool:
        """Return True if the process is at another entry than at the last call."""
        before, self._seen = self._seen, self._board.at
        return self._seen != before

    def hurry(self) -> None:
        """Ask the process to answer after the entry it is at."""
        self._board.hurry = True

    def kill(self) -> None:
        """Kill the process; a thread that waits for it gets `LearnerEnded`. Any thread."""
        self._process.kill()

    def close(self) -> None:
        """Kill the process and close everything; may be called twice."""
        if not self._ended:
            self._ended = True
            self.kill()
            self._process.wait(END_SECONDS)
            self._in.close()
            self._out.close()
            self._board.close()

    def _end(self) -> LearnerEnded:
        """Wait until the process has ended, and return how."""
        try:
            status = self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            # It has closed its end but still runs, or the system is very slow.
            self.kill()
            status = self._process.wait(END_SECONDS)
        return LearnerEnded(status, self._board.at)
