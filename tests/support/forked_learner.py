"""Learner processes that start in milliseconds: forks of one that has imported everything.

Importing scipy takes about a second of processor time per process, and the tests start hundreds of
learners. A server process imports the learner once and forks for each start. The forks are real
processes with the pipes, the signal mask, the environment, the statuses and the niceness of the
program's. Two servers take turns, so that a restarted learner hashes strings in another order, as
a new program does. `test_learner_process.py` and all tests that start the daemon as a program have
the real thing.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import itertools
import os
import runpy
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import IO, NoReturn

import msgspec

WORKER = "camtopod.serve.learner_process.worker"
"""The program that the server imports; others are run as they are."""
_NUMBER = struct.Struct("i")
_MESSAGE_BYTES_MAX = 1 << 17


class Start(msgspec.Struct):
    """What the server has to start."""

    program: str
    environment: dict[str, str]
    blocked: list[int]


# --- in the process of the tests ------------------------------------------------------------------


class ForkServer:
    """A process that forks learners."""

    def __init__(self) -> None:
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", __file__, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            )

    def start(self, start: Start, fds: Sequence[int]) -> None:
        """Start a learner with these as stdin, stdout, stderr, its status and its board."""
        socket.send_fds(self._control, [msgspec.msgpack.encode(start)], list(fds))

    def close(self) -> None:
        self._control.close()
        self._process.wait()


class ForkedLearner:
    """Does for a forked learner what `subprocess.Popen` does for a program."""

    def __init__(
        self, server: ForkServer, program: str, board: int, environment: Mapping[str, str]
    ) -> None:
        in_theirs, in_ours = os.pipe()
        out_ours, out_theirs = os.pipe()
        self._ends, ends_theirs = os.pipe()
        self.stdin: IO[bytes] = os.fdopen(in_ours, "wb", 0)
        self.stdout: IO[bytes] = os.fdopen(out_ours, "rb", 0)
        theirs = (in_theirs, out_theirs, ends_theirs)
        blocked = [int(number) for number in signal.pthread_sigmask(signal.SIG_BLOCK, ())]
        try:
            server.start(
                Start(program, dict(environment), blocked),
                (in_theirs, out_theirs, 2, ends_theirs, board),
            )
        finally:
            for fd in theirs:
                os.close(fd)
        self._mutex = threading.Lock()
        self._status: int | None = None
        self.pid = self._read()

    def _read(self) -> int:
        return int(_NUMBER.unpack(os.read(self._ends, _NUMBER.size))[0])

    def poll(self) -> int | None:
        """Return the status if the process has ended."""
        with self._mutex:
            if self._status is None and select.select([self._ends], [], [], 0)[0]:
                self._status = self._read()
                os.close(self._ends)
            return self._status

    def wait(self, timeout: float) -> int:
        """Return the status; raise `subprocess.TimeoutExpired` if that takes too long."""
        until = time.monotonic() + timeout
        while (status := self.poll()) is None:
            if time.monotonic() > until:
                raise subprocess.TimeoutExpired("learner", timeout)
            time.sleep(0.001)
        return status

    def kill(self) -> None:
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)


@contextlib.contextmanager
def forked_learners() -> Iterator[None]:
    """In this block, `LearnerProcess` forks."""
    from camtopod.serve.learner_process import process

    servers: dict[int, ForkServer] = {}
    turns, mutex = itertools.cycle(range(2)), threading.Lock()

    def popen(
        command: Sequence[str],
        *,
        pass_fds: Sequence[int],
        env: Mapping[str, str],
        **_: object,
    ) -> ForkedLearner:
        *_, program, board = command
        assert pass_fds == [int(board)]
        with mutex:
            turn = next(turns)
            server = servers[turn] = servers.get(turn) or ForkServer()
        return ForkedLearner(server, program, int(board), env)

    forking = SimpleNamespace(
        Popen=popen, PIPE=subprocess.PIPE, TimeoutExpired=subprocess.TimeoutExpired
    )
    with _replaced(process, forking):
        try:
            yield
        finally:
            for server in servers.values():
                server.close()


@contextlib.contextmanager
def real_learners() -> Iterator[None]:
    """In this block, `LearnerProcess` starts programs, as it does for users."""
    from camtopod.serve.learner_process import process

    with _replaced(process, subprocess):
        yield


@contextlib.contextmanager
def _replaced(process: object, by: object) -> Iterator[None]:
    before = process.subprocess  # type: ignore[attr-defined]
    process.subprocess = by  # type: ignore[attr-defined]
    try:
        yield
    finally:
        process.subprocess = before  # type: ignore[attr-defined]


# --- in the server --------------------------------------------------------------------------------


def serve(control: socket.socket) -> NoReturn:
    """Fork until the tests end."""
    importlib.import_module(WORKER)
    assert len(list(Path("/proc/self/task").iterdir())) == 1, "forks of threads cannot be relied on"
    gc.collect()
    gc.freeze()
    ended, ends = os.pipe()
    for fd in (ended, ends):
        os.set_blocking(fd, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(ends)

    running: dict[int, int] = {}
    while True:
        ready, *_ = select.select([control, ended], [], [])
        if ended in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(ended, 4096)
            _tell_ends(running)
        if control in ready:
            packed, fds, *_ = socket.recv_fds(control, _MESSAGE_BYTES_MAX, 5)
            if not packed:
                os._exit(0)
            start = msgspec.msgpack.decode(packed, type=Start)
            status = fds[3]
            if (pid := os.fork()) == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                for fd in (control.fileno(), ended, ends, status, *running.values()):
                    os.close(fd)
                _learn(start, fds)
            for fd in fds:
                if fd != status:
                    os.close(fd)
            running[pid] = status
            os.write(status, _NUMBER.pack(pid))


def _tell_ends(running: dict[int, int]) -> None:
    """Tell how the processes that have ended did so."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            status = running.pop(ended[0])
            with contextlib.suppress(BrokenPipeError):
                os.write(status, _NUMBER.pack(os.waitstatus_to_exitcode(ended[1])))
            os.close(status)


def _learn(start: Start, fds: Sequence[int]) -> NoReturn:
    """Be the learner."""
    *standard, _, board = fds
    for number, fd in enumerate(standard):
        os.dup2(fd, number)
        os.close(fd)
    os.environ.clear()
    os.environ.update(start.environment)
    signal.pthread_sigmask(signal.SIG_SETMASK, start.blocked)
    sys.argv = [start.program, str(board)]
    status = 0
    try:
        if start.program == WORKER:
            importlib.import_module(WORKER).main()
        else:
            runpy.run_module(start.program, run_name="__main__", alter_sys=True)
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
        status = 1
    sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
