"""The daemon's handle of the learner's process: start it, ask it, and end it."""

from __future__ import annotations

import atexit
import importlib
import multiprocessing
import os
from ctypes import c_longlong
from multiprocessing import heap
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext

from camtopod.serve.learner_process.messages import STATE, Answer, Kind, Question

PROGRAM = "camtopod.serve.learner_process.worker"
"""The module whose `main` the process runs."""
END_SECONDS = 5.0
"""Longest time, in seconds, for the system to end a process that was killed."""

MEMORY = "/dev/shm"
"""Directory of the memory that is shared with the process; without it, a temporary file is."""
if not os.access(MEMORY, os.W_OK):
    heap.Arena._dir_candidates = []  # type: ignore[attr-defined]

context: BaseContext = multiprocessing.get_context("spawn")
"""How processes start: not as forks of the daemon, which has threads and open files."""


class LearnerEnded(RuntimeError):
    """The learner's process has ended by itself.

    status: its exit status, or the negative number of the signal that ended it.
    at: the journal entry it was at; 0: none; STATE: what it has learned.
    """

    def __init__(self, status: int, at: int) -> None:
        place = f"entry {at} of the journal"
        if at == STATE:
            place = "the state that it continues from"
        super().__init__(f"the learner's process has ended with status {status}, at {place}")
        self.status = status
        self.at = at


def _run(program: str, pipe: Connection, entry: c_longlong) -> None:
    """Run in the new process; only there is the learner's code imported."""
    importlib.import_module(program).main(pipe, entry)


class LearnerProcess:
    """The learner's process, from its start until `close`, which has to be called.

    One thread asks at a time.

    program: the module whose `main` it runs.
    """

    def __init__(self, program: str = PROGRAM) -> None:
        self._pipe, far_end = context.Pipe()
        # Shared memory, which can be read even after the process was killed.
        self._entry: c_longlong = context.RawValue(c_longlong, 0)
        self._last_entry = 0
        self._process = context.Process(  # type: ignore[attr-defined]
            target=_run, args=(program, far_end, self._entry), name="learner"
        )
        self._process.start()
        self.pid: int = self._process.pid
        """Process id."""
        far_end.close()
        atexit.register(self.close)  # before multiprocessing waits for the process

    def send(self, question: Question) -> None:
        """Send a question, after everything before has been answered. Raises `LearnerEnded`."""
        try:
            self._pipe.send(question)
        except OSError:
            raise self._ended() from None

    def receive(self, seconds: float) -> Answer | None:
        """Return the answer; None if ``seconds`` pass without one. Raises `LearnerEnded`."""
        try:
            if not self._pipe.poll(seconds):
                return None
            answer: Answer = self._pipe.recv()
        except (EOFError, OSError):
            raise self._ended() from None
        return answer

    def ask(self, question: Question, kind: type[Kind]) -> Kind:
        """Send a question and return its answer of this kind. Raises `LearnerEnded`."""
        self.send(question)
        while (answer := self.receive(1.0)) is None:
            pass
        assert isinstance(answer, kind)
        return answer

    def check(self) -> None:
        """Raise `LearnerEnded` if the process has ended."""
        if not self._process.is_alive():
            raise self._ended()

    def has_progressed(self) -> bool:
        """Return True if the process is at another entry than at the last call."""
        before = self._last_entry
        self._last_entry = self._entry.value
        return self._last_entry != before

    def close(self) -> None:
        """Kill the process; a thread that waits for it gets `LearnerEnded`. May be called twice."""
        atexit.unregister(self.close)
        self._process.kill()
        self._process.join(END_SECONDS)

    def _ended(self) -> LearnerEnded:
        """Return how the process has ended; one that has only closed its end is killed."""
        self._process.join(END_SECONDS)
        if self._process.exitcode is None:
            self.close()
        return LearnerEnded(self._process.exitcode or 0, self._entry.value)
