"""One camera's process: started, heard, ended if it hangs, and started again after a while.

A watchdog ends the process and not the capture: releasing a capture from another thread crashes
anyway. Nothing here waits, so no camera holds up another; time is an argument.
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
from camtopod.cli.cameras.heartbeat import Ear
from camtopod.config import CameraSettings, HealthSettings
from camtopod.serve.runtime import SOCKET_VARIABLE
from camtopod.vision.source import kind_of

log = logging.getLogger(__name__)

TRACE_SECONDS = 0.3
"""A process that hangs has this long to say where (SIGUSR1) before it is killed."""
STOP_SECONDS = 4.5
"""A process that was told to end is killed after this long."""
START_FACTOR_MAX = 16
"""A process that took too long to be there gets twice the time when it is started again, up to
this: many that start at once on a small machine would otherwise be killed for ever."""
LOOK_SECONDS_MAX = 2.0
"""A longer time between two looks says nothing about the process looked after."""
_HOPELESS = (exits.USAGE, exits.CONFIG)
"""With these statuses starting again changes nothing."""
_WORDS = {
    exits.FAILED: "failed",
    exits.USAGE: "refused its command line",
    exits.INPUT: "cannot read its source",
    exits.BUS: "cannot reach the bus",
    exits.STATE: "cannot write its state directory",
    exits.CONFIG: "refused the configuration",
}

Command = Callable[[str, int, str, int], Sequence[str]]
"""(camera, restarts, why it ended last, file descriptor for its heartbeats) -> command line."""


def backoff_after(
    backoff: float, ran: float, health: HealthSettings, chance: Callable[[], float] = random.random
) -> tuple[float, float]:
    """(seconds to wait now, backoff for the next time) after a process that ran for ``ran``
    seconds.
    """
    if ran >= health.restart_seconds_max:
        backoff = health.restart_seconds_min
    return backoff * (0.5 + chance()), min(2 * backoff, health.restart_seconds_max)


def in_words(status: int) -> str:
    """Why a process ended, from its exit status as `subprocess` gives it."""
    if status >= 0:
        return f"{_WORDS.get(status, 'failed')} (status {status})"
    known = {number.value: number.name for number in signal.Signals}
    return f"killed by {known.get(-status, f'signal {-status}')}"


def restarted(times: int, why: str, reason: str = "") -> str:
    """``reason``, and behind it how often the camera's process was started again and why the last
    time.
    """
    if not times:
        return reason
    said = f"restarted {'once' if times == 1 else f'{times} times'}, last: {why}"
    return f"{reason}; {said}" if reason and reason != why else said


@contextmanager
def _without_hangup() -> Iterator[None]:
    """What starts in the block has SIGHUP blocked until it can take it, however early that
    comes.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGHUP])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Child:
    """The process of one camera, there or to be started."""

    def __init__(self, camera: str, settings: CameraSettings, health: HealthSettings) -> None:
        self.camera, self.settings, self._health = camera, settings, health
        self.process: subprocess.Popen[bytes] | None = None
        self.state, self.reason = "connecting", ""
        self.daemon: str | None = None
        """Why its process does not reach the daemon; "" if it does, None where that is not
        known.
        """
        self.restarts = 0
        self.last_end = ""
        """Why the last process ended."""
        self.status = 0
        """The last exit status; 1 after a signal."""
        self.again_at: float | None = 0.0
        """When to start, on the monotonic clock; None: it runs, has ended, or is hopeless."""
        self._backoff = health.restart_seconds_min
        self._started = self._heard = self._looked = 0.0
        self._spoke = False
        self._slow_starts = 0
        self._ear: Ear | None = None
        self._kill_at: float | None = None
        self._hung = ""
        self._told = False

    @property
    def over(self) -> bool:
        """No process, and none to be started."""
        return self.process is None and self.again_at is None

    @property
    def silent(self) -> bool:
        """Whether there is no process that speaks for the camera on the bus."""
        return self.process is None or not self._spoke

    def look_after(self, now: float, command: Command, config_fd: int) -> None:
        """Start it, hear it, end it, as it needs; never waits."""
        if self.process is None:
            if self.again_at is not None and now >= self.again_at:
                self._start(now, command, config_fd)
            return
        assert self._ear is not None
        if now - self._looked > LOOK_SECONDS_MAX:
            self._heard = now  # whoever was not there, as the whole machine perhaps, cannot say what was to be heard
        self._looked = now
        status = self.process.poll()  # first: what it said before it ended counts
        said = self._ear.listen()
        if said is not None:
            self._heard, self._spoke, self._slow_starts = now, True, 0
            self.state, self.reason = said.state, said.reason
            self.daemon = said.daemon
        if status is not None:
            self._ended(status, now)
        elif self._kill_at is not None:
            if now >= self._kill_at:
                self.process.kill()  # one that cannot even be killed is waited for: it holds the spool
        elif now - self._heard > self._allowed():
            self._hung = f"hung for {now - self._heard:.0f} s while {self.state}"
            log.error("camera %s: the process %s; it is killed", self.camera, self._hung)
            self._slow_starts += not self._spoke
            self.process.send_signal(signal.SIGUSR1)
            self._kill_at = now + TRACE_SECONDS

    def tell_to_end(self, now: float, then_at: float | None = None) -> None:
        """End it soon, and start it anew after ``then_at`` (None: not again)."""
        self.again_at = then_at
        if self.process is not None and not self._told:
            self._told = True
            self.process.terminate()
            self._kill_at = min(self._kill_at or math.inf, now + STOP_SECONDS)

    def renew(
        self, settings: CameraSettings, health: HealthSettings, now: float, restart: bool
    ) -> None:
        """Another configuration; with ``restart`` its process starts anew under it, at once."""
        self.settings, self._health = settings, health
        if restart:
            self._backoff = health.restart_seconds_min
            self.tell_to_end(now, then_at=now)

    def summary(self, now: float) -> dict[str, Any]:
        """For ``status/{camera}`` while no process speaks for it."""
        reason = restarted(self.restarts, self.last_end, self.reason)
        if self.process is None and self.again_at is not None:
            reason = f"again in {max(0.0, self.again_at - now):.0f} s; {reason}"
        return {
            "camera": self.camera,
            "state": self.state,
            "reason": reason,
            "restarts": self.restarts,
            "last_end": self.last_end,
        }

    def _allowed(self) -> float:
        if self._spoke:
            return self._health.hung_seconds
        return self._health.start_seconds * min(1 << self._slow_starts, START_FACTOR_MAX)

    def _start(self, now: float, command: Command, config_fd: int) -> None:
        try:
            self._ear = ear = Ear()
        except OSError as error:
            self._again(now, 0.0, f"cannot be started: {error.strerror}")
            return
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
        except OSError as error:  # no memory, no process: perhaps later
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
        assert self._ear is not None
        self._ear.close()
        self.daemon = None
        self.process, self.status = None, status if status >= 0 else exits.FAILED
        if self._told:
            self.status = 0
            self.state, self.reason = "ended", ""
        elif status == exits.DONE and self.state == "ended":  # a file; a stream never does
            log.info("camera %s has ended", self.camera)
        elif status in _HOPELESS:
            self.state, self.reason = "failed", f"{in_words(status)}; it is not started again"
            log.error("camera %s %s", self.camera, self.reason)
        else:
            why = self._hung or ("ended by itself" if status == exits.DONE else in_words(status))
            if self.state in ("running", "ended") and kind_of(self.settings.source) == "file":
                self.state, self.reason = (
                    "failed",
                    f"{why}; a file is not begun again, or its events would count twice",
                )
                log.error("camera %s: %s", self.camera, self.reason)
            else:
                self._again(now, now - self._started, why)

    def _again(self, now: float, ran: float, why: str) -> None:
        wait, self._backoff = backoff_after(self._backoff, ran, self._health)
        self.again_at = now + wait
        self.restarts += 1
        self.last_end = why
        self.state, self.reason = "restarting", why
        log.warning(
            "camera %s: %s; again in %.1f s (restart %d)", self.camera, why, wait, self.restarts
        )
