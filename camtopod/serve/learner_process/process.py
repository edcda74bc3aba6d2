"""The daemon's handle of the learner's process: start it, ask it, and end it."""

from __future__ import annotations

import atexit
import importlib
import math
import multiprocessing
import time
from ctypes import c_longlong
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext

from camtopod.serve.learner_process.messages import Answer, Kind, Question

PROGRAM = "camtopod.serve.learner_process.worker"
"""The module whose `main` the process runs."""
END_SECONDS = 5.0
"""Longest time, in seconds, for the system to end a process that was killed."""

context: BaseContext = multiprocessing.get_context("spawn")
"""How processes start: not as forks of the daemon, which has threads and open files."""


class LearnerEnded(RuntimeError):
    """The learner's process has ended by itself.

    status: its exit status, or the negative number of the signal that ended it.
    at: the journal entry it was at; 0: none.
    """

    def __init__(self, status: int, at: int) -> None:
        how = f"status {status}" if status >= 0 else f"signal {-status}"
        where = f" at entry {at} of the journal" if at else ""
        super().__init__(f"the learner's process has ended ({how}){where}")
        self.status = status
        self.at = at


def _run(program: str, pipe: Connection, entry: c_longlong, hurry: c_longlong) -> None:
    """Run in the new process; only there is the learner's code imported."""
    importlib.import_module(program).main(pipe, entry, hurry)


class LearnerProcess:
    """The learner's process, from its start until `close`, which has to be called.

    One thread asks at a time.

    program: the module whose `main` it runs.
    """

    def __init__(self, program: str = PROGRAM) -> None:
        self._pipe, theirs = context.Pipe()
        # Shared memory, which can be read even after the process was killed.
        self._entry: c_longlong = context.RawValue(c_longlong, 0)
        self._hurry: c_longlong = context.RawValue(c_longlong, 0)
        self._seen = 0
        self._ended = False
        self._process = context.Process(  # type: ignore[attr-defined]
            target=_run, args=(program, theirs, self._entry, self._hurry), name="learner"
        )
        self._process.start()
        self.pid: int = self._process.pid
        """Process id."""
        theirs.close()
        atexit.register(self.close)  # before multiprocessing waits for the process

    def send(self, question: Question) -> None:
        """Send a question, after everything before has been answered. Raises `LearnerEnded`."""
        try:
            self._pipe.send(question)
        except OSError:
            raise self._end() from None

    def receive(self, seconds: float) -> Answer | None:
        """Return the next answer; None if ``seconds`` pass without one. Raises `LearnerEnded`."""
        try:
            if not self._pipe.poll(seconds):
                return None
            answer: Answer = self._pipe.recv()
        except (EOFError, OSError):
            raise self._end() from None
        return answer

    def ask(self, question: Question, kind: type[Kind], seconds_max: float = math.inf) -> Kind:
        """Send a question and return its answer of this kind. Raises `LearnerEnded`.

        The process is killed after ``seconds_max``.
        """
        until = time.monotonic() + seconds_max
        self.send(question)
        while (answer := self.receive(0.2)) is None:
            if time.monotonic() > until:
                self.kill()
        assert isinstance(answer, kind)
        return answer

    def check(self) -> None:
        """Raise `LearnerEnded` if the process has ended."""
        if self._process.exitcode is not None:
            raise self._end()

    def has_progressed(self) -> bool:
        """Return True if the process is at another entry than at the last call."""
        before = self._seen
        self._seen = self._entry.value
        return self._seen != before

    def hurry(self) -> None:
        """Ask the process to answer after the entry it is at."""
        self._hurry.value = 1

    def kill(self) -> None:
        """Kill the process; a thread that waits for it gets `LearnerEnded`. Any thread."""
        if not self._ended:
            self._process.kill()

    def close(self) -> None:
        """Kill the process and close everything; may be called twice."""
        if self._ended:
            return
        atexit.unregister(self.close)
        self.kill()
        self._process.join(END_SECONDS)
        self._ended = True
        self._process.close()
        self._pipe.close()

    def _end(self) -> LearnerEnded:
        """Wait until the process has ended, and return how."""
        self._process.join(END_SECONDS)
        if self._process.exitcode is None:
            # It has closed its end but still runs, or the system is very slow.
            self._process.kill()
            self._process.join(END_SECONDS)
        return LearnerEnded(self._process.exitcode or 0, self._entry.value)
