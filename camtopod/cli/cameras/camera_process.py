"""Process of one camera: started, watched by heartbeats, killed if it hangs, and restarted later.

A watchdog kills the whole process, as releasing a capture from another thread crashes anyway. No
function here waits, so no camera delays another; the time is an argument (monotonic, seconds).
"""

from __future__ import annotations

import logging
import math
import os
import random
import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from camtopod.cli import exits
from camtopod.cli.cameras.heartbeat import HeartbeatReceiver
from camtopod.config import CameraSettings, HealthSettings
from camtopod.serve.runtime import SOCKET_VARIABLE
from camtopod.vision.source import kind_of

log = logging.getLogger(__name__)

TRACE_SECONDS = 0.3
"""Time that a hung process has to log where it hangs (SIGUSR1) before it is killed."""
STOP_SECONDS = 4.5
"""Time after which a process that was asked to end is killed."""
START_FACTOR_MAX = 16
"""Upper bound of the factor on the start timeout.

Each slow start doubles the timeout of the next one; otherwise many cameras that start at once on a
small machine would be killed forever.
"""
LOOK_SECONDS_MAX = 2.0
"""After a longer gap between two looks, silence says nothing about the watched process."""
_HOPELESS = (exits.USAGE, exits.CONFIG)
"""Exit statuses after which a restart would not help."""
_WORDS = {
    exits.FAILED: "failed",
    exits.USAGE: "refused its command line",
    exits.INPUT: "cannot read its source",
    exits.BUS: "cannot reach the bus",
    exits.STATE: "cannot write its state directory",
    exits.CONFIG: "refused the configuration",
}
"""Exit status -> its meaning in words."""

Command = Callable[[str, int, str, int], Sequence[str]]
"""Function (camera, restarts, why it ended last, file descriptor for heartbeats) -> command line.
"""


def backoff_after(
    backoff: float, ran: float, health: HealthSettings, chance: Callable[[], float] = random.random
) -> tuple[float, float]:
    """Return (seconds to wait now, next backoff) after a process that ran for ``ran`` seconds."""
    if ran >= health.restart_seconds_max:
        backoff = health.restart_seconds_min
    return backoff * (0.5 + chance()), min(2 * backoff, health.restart_seconds_max)


def exit_reason(status: int) -> str:
    """Return why a process ended, from its exit status as `subprocess` gives it."""
    if status >= 0:
        return f"{_WORDS.get(status, 'failed')} (status {status})"
    known = {number.value: number.name for number in signal.Signals}
    return f"killed by {known.get(-status, f'signal {-status}')}"


def with_restarts(times: int, why: str, reason: str = "") -> str:
    """Return ``reason`` followed by the number of restarts and the cause of the last one."""
    if not times:
        return reason
    said = f"restarted {'once' if times == 1 else f'{times} times'}, last: {why}"
    return f"{reason}; {said}" if reason and reason != why else said


@contextmanager
def _without_hangup() -> Iterator[None]:
    """Block SIGHUP in processes started in this block, until they unblock it themselves."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGHUP])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class CameraProcess:
    """Process of one camera, running or waiting to be started."""

    def __init__(self, camera: str, settings: CameraSettings, health: HealthSettings) -> None:
        self.camera, self.settings, self._health = camera, settings, health
        self.process: subprocess.Popen[bytes] | None = None
        self.state, self.reason = "connecting", ""
        self.daemon: str | None = None
        """Reason why the process does not reach the daemon; "" if it does, None if unknown."""
        self.restarts = 0
        self.last_end = ""
        """Reason why the last process ended."""
        self.status = 0
        """Last exit status; 1 after a signal."""
        self.again_at: float | None = 0.0
        """Time of the next start, monotonic clock.

        None if the process is running, has ended, or must not be restarted.
        """
        self._backoff = health.restart_seconds_min
        self._started = self._heard = self._looked = 0.0
        self._spoke = False
        self._slow_starts = 0
        self._ear: HeartbeatReceiver | None = None
        self._kill_at: float | None = None
        self._hung = ""
        self._told = False

    @property
    def over(self) -> bool:
        """Return True if there is no process and none is to be started."""
        return self.process is None and self.again_at is None

    @property
    def silent(self) -> bool:
        """Return True if no process publishes the camera's status."""
        return self.process is None or not self._spoke

    def look_after(self, now: float, command: Command, config_fd: int) -> None:
        """Start the process, read its heartbeats, or kill it, as needed; never waits."""
        if self.process is None:
            if self.again_at is not None and now >= self.again_at:
                self._start(now, command, config_fd)
            return
        assert self._ear is not None
        if now - self._looked > LOOK_SECONDS_MAX:
            self._heard = now  # this process was suspended, too, and may have missed heartbeats
        self._looked = now

        # Read the last heartbeat.
        status = self.process.poll()  # before reading, so that its last heartbeat counts
        said = self._ear.listen()
        if said is not None:
            self._heard, self._spoke, self._slow_starts = now, True, 0
            self.state, self.reason = said.state, said.reason
            self.daemon = said.daemon

        # Handle its end, or kill it when its time is over.
        if status is not None:
            self._ended(status, now)
        elif self._kill_at is not None:
            if now >= self._kill_at:
                self.process.kill()  # if it survives, wait for it: it holds the spool
        elif now - self._heard > self._allowed():
            self._hung = f"hung for {now - self._heard:.0f} s while {self.state}"
            log.error("camera %s: the process %s; killing it", self.camera, self._hung)
            self._slow_starts += not self._spoke
            self.process.send_signal(signal.SIGUSR1)
            self._kill_at = now + TRACE_SECONDS

    def request_end(self, now: float, then_at: float | None = None) -> None:
        """Ask the process to end, and start it again after ``then_at`` (None: not again)."""
        self.again_at = then_at
        if self.process is not None and not self._told:
            self._told = True
            self.process.terminate()
            self._kill_at = min(self._kill_at or math.inf, now + STOP_SECONDS)

    def renew(
        self, settings: CameraSettings, health: HealthSettings, now: float, restart: bool
    ) -> None:
        """Apply a new configuration; with ``restart`` the process restarts at once."""
        self.settings, self._health = settings, health
        if restart:
            self._backoff = health.restart_seconds_min
            self.request_end(now, then_at=now)

    def summary(self, now: float) -> dict[str, Any]:
        """Return the status for ``status/{camera}`` while no process publishes it."""
        reason = with_restarts(self.restarts, self.last_end, self.reason)
        if self.process is None and self.again_at is not None:
            reason = f"restarting in {max(0.0, self.again_at - now):.0f} s; {reason}"
        return {
            "camera": self.camera,
            "state": self.state,
            "reason": reason,
            "restarts": self.restarts,
            "last_end": self.last_end,
        }

    def _allowed(self) -> float:
        """Return how long the process may be silent, seconds."""
        if self._spoke:
            return self._health.hung_seconds
        return self._health.start_seconds * min(1 << self._slow_starts, START_FACTOR_MAX)

    def _start(self, now: float, command: Command, config_fd: int) -> None:
        """Start the process with a pipe for its heartbeats."""
        try:
            self._ear = ear = HeartbeatReceiver()
        except OSError as error:
            self._again(now, 0.0, f"cannot be started: {error.strerror}")
            return

        # The child reports to this process, not to systemd.
        environment = {
            k: v for k, v in os.environ.items() if k not in (SOCKET_VARIABLE, "WATCHDOG_USEC")
        }
        line = command(self.camera, self.restarts, self.last_end, ear.child_fd)
        try:
            with _without_hangup():
                self.process = subprocess.Popen(
                    line,
                    stdin=subprocess.DEVNULL,
                    env=environment,
                    pass_fds=(ear.child_fd, config_fd),
                )
        except OSError as error:  # no memory or too many processes: try again later
            ear.close()
            self._again(now, 0.0, f"cannot be started: {error.strerror}")
        else:
            self._started = self._heard = self._looked = now
            self._spoke = self._told = False
            self._kill_at, self._hung, self.again_at = None, "", None
            self.state, self.reason = "connecting", "the process is starting"
        finally:
            os.close(ear.child_fd)

    def _ended(self, status: int, now: float) -> None:
        """Handle the end of the process: finished, failed for good, or to be restarted."""
        assert self._ear is not None
        self._ear.close()
        self.daemon = None
        self.process, self.status = None, status if status >= 0 else exits.FAILED

        # Asked to end, finished, failed for good, or to be restarted.
        if self._told:
            self.status = 0
            self.state, self.reason = "ended", ""
        elif status == exits.DONE and self.state == "ended":  # a file; a stream never ends
            log.info("camera %s has ended", self.camera)
        elif status in _HOPELESS:
            self.state, self.reason = "failed", f"{exit_reason(status)}; it is not restarted"
            log.error("camera %s %s", self.camera, self.reason)
        else:
            why = self._hung or ("ended by itself" if status == exits.DONE else exit_reason(status))
            if self.state in ("running", "ended") and kind_of(self.settings.source) == "file":
                self.state, self.reason = (
                    "failed",
                    f"{why}; not restarted, as the events of a file would count twice",
                )
                log.error("camera %s: %s", self.camera, self.reason)
            else:
                self._again(now, now - self._started, why)

    def _again(self, now: float, ran: float, why: str) -> None:
        """Schedule a restart."""
        wait, self._backoff = backoff_after(self._backoff, ran, self._health)
        self.again_at = now + wait
        self.restarts += 1
        self.last_end = why
        self.state, self.reason = "restarting", why
        log.warning(
            "camera %s: %s; restarting in %.1f s (restart %d)",
            self.camera,
            why,
            wait,
            self.restarts,
        )
