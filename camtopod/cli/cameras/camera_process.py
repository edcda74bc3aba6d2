"""Process of a camera or a part: started, watched by heartbeats, killed if it hangs, restarted.

A hung process is killed as a whole, as releasing a capture from another thread crashes anyway. No
function here waits, so no camera delays another; the time is an argument (monotonic, seconds).
"""

from __future__ import annotations

import logging
import os
import random
import signal
import subprocess
from collections.abc import Sequence
from typing import Any

from camtopod.cli import exits
from camtopod.cli.cameras.heartbeat import HeartbeatReceiver, state_of
from camtopod.cli.common import counted
from camtopod.config import CameraSettings, Config
from camtopod.serve.runtime import SOCKET_VARIABLE, clock
from camtopod.vision.source import kind_of

log = logging.getLogger(__name__)

HUNG_SECONDS = 30.0
"""A camera's process without a heartbeat for this long is killed and restarted."""
START_SECONDS = 30.0
"""Time that its start may take in addition: OpenCV loads slowly on a small machine."""
RESTART_SECONDS_MIN = 1.0
"""First wait before a camera's process is restarted; it doubles up to `RESTART_SECONDS_MAX`."""
RESTART_SECONDS_MAX = 60.0
"""Largest wait; after a run of this length the first wait is used again."""
STOP_SECONDS = 4.5
"""Time after which a process that was asked to end, or to log where it hangs, is killed."""


def exit_reason(status: int) -> str:
    """Return why a process ended, from its exit status as `subprocess` gives it."""
    if status < 0:
        return f"killed by signal {-status} ({signal.strsignal(-status)})"
    return f"ended with status {status}"


def camera_status(
    camera: str, state: str, reason: str, restarts: int, last_end: str
) -> dict[str, Any]:
    """Return the content of ``status/{camera}`` that all cameras have.

    The reason is followed by the number of restarts and the cause of the last one.
    """
    if restarts:
        history = f"restarted {counted(restarts, 'time')}, last: {last_end}"
        reason = history if reason in ("", last_end) else f"{reason}; {history}"
    return {
        "camera": camera,
        "state": state,
        "reason": reason,
        "restarts": restarts,
        "last_end": last_end,
        "t": clock.wall(),
    }


def site_status(config: Config, camera: str) -> dict[str, Any]:
    """Return the part of a status that follows from the configuration: interval and sites."""
    sites = config.sites_of(camera)
    return {"status_seconds": config.limits.status_seconds, "owner": sites[0], "sites": sites}


class ChildProcess:
    """A process of `grab` or `up`, running or waiting to be started.

    name: what it is called in the log.
    hung_seconds: time without a heartbeat after which it is killed and restarted.
    stop_seconds: time after which it is killed when it was asked to end, or to log where it hangs.
    process_group: as of `subprocess.Popen`.
    """

    given_up = frozenset({exits.USAGE})
    """Exit statuses after which it is not restarted."""

    def __init__(
        self,
        name: str,
        hung_seconds: float,
        stop_seconds: float,
        process_group: int | None = None,
    ) -> None:
        self.name = name
        self.process: subprocess.Popen[bytes] | None = None
        self.state = "connecting"
        self.reason = ""
        self.restarts = 0
        self.last_end = ""
        """Reason why the last process ended."""
        self.status = 0
        """Last exit status; 1 after a signal."""
        self.start_at: float | None = 0.0
        """Time of the next start, monotonic clock.

        None if the process is running, has ended, or must not be restarted.
        """
        self._hung_seconds = hung_seconds
        self._stop_seconds = stop_seconds
        self._process_group = process_group
        self._backoff = RESTART_SECONDS_MIN
        self._receiver: HeartbeatReceiver | None = None
        self._started_at = 0.0
        self._has_reported = False
        self._heard_at = 0.0
        self._kill_at: float | None = None
        self._hang = ""
        """How long the process was silent, in words, if it is being killed for that."""
        self._asked_to_end = False

    @property
    def over(self) -> bool:
        """Return True if there is no process and none is to be started."""
        return self.process is None and self.start_at is None

    def look_after(self, now: float, command: Sequence[str]) -> None:
        """Start the process, read its heartbeats, or kill it, as needed; never waits.

        command: the process's command line.
        """
        if self.process is None:
            if self.start_at is not None and now >= self.start_at:
                self._start(now, command)
            return

        # Read the last heartbeats.
        assert self._receiver is not None
        status = self.process.poll()  # before reading, so that its last heartbeat counts
        if lines := self._receiver.lines():
            self._hear(lines)
            self._heard_at = now

        # Handle its end, or kill it when its time is over.
        silence = now - self._heard_at
        if status is not None:
            self._receiver.close()
            self.process = None
            self._ended(status, now)
        elif self._kill_at is not None:
            if now >= self._kill_at:
                self.process.kill()  # if it survives, wait for it: it holds the spool
        elif silence > self._hung_seconds:
            self._hang = f"hung for {silence:.0f} s while {self.state}"
            log.error("%s: the process %s; killing it", self.name, self._hang)
            self._signal(signal.SIGABRT, now)  # it logs where it hangs

    def request_end(self, now: float, start_at: float | None = None) -> None:
        """Ask the process to end, and start it again at ``start_at`` (None: not again)."""
        self.start_at = start_at
        if self.process is not None and not self._asked_to_end:
            self._asked_to_end = True
            self._signal(signal.SIGTERM, now)

    def _hear(self, lines: Sequence[str]) -> None:
        """Take the lines of its notifications since the last call."""
        self._has_reported = True
        if "READY=1" in lines:
            self.state = "running"

    def _signal(self, number: signal.Signals, now: float) -> None:
        """Send a signal that should end the process; it is killed if it does not."""
        assert self.process is not None
        self.process.send_signal(number)
        if self._kill_at is None:
            self._kill_at = now + self._stop_seconds

    def _start(self, now: float, command: Sequence[str]) -> None:
        """Start the process, which sends its heartbeats to this one instead of systemd."""
        environment = os.environ.copy()
        environment.pop("WATCHDOG_USEC", None)
        try:
            self._receiver = HeartbeatReceiver()
            environment[SOCKET_VARIABLE] = self._receiver.address
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                env=environment,
                process_group=self._process_group,
            )
        except OSError as error:  # no memory, too many files or processes: try again later
            if self._receiver is not None:
                self._receiver.close()
            self._restart_later(now, 0.0, f"cannot be started: {error.strerror}")
            return
        self.start_at = None
        self.state = "connecting"
        self.reason = "the process is starting"
        self._started_at = now
        self._has_reported = False
        self._heard_at = now + START_SECONDS
        self._kill_at = None
        self._hang = ""
        self._asked_to_end = False

    def _ended(self, status: int, now: float) -> None:
        """Handle the end of the process: asked for, failed for good, or to be restarted."""
        self.status = status if status >= 0 else exits.FAILED
        if self._asked_to_end:
            self.status = exits.DONE
            self.state = "ended"
            self.reason = ""
        elif status in self.given_up:
            self._give_up(f"{exit_reason(status)}; it is not restarted")
        else:
            self._restart_later(now, now - self._started_at, self._hang or exit_reason(status))

    def _give_up(self, reason: str) -> None:
        """Note and log why the process is not started again."""
        self.state = "failed"
        self.reason = reason
        log.error("%s: %s", self.name, reason)

    def _restart_later(self, now: float, run_seconds: float, cause: str) -> None:
        """Schedule a restart; the wait doubles unless the process ran for a while."""
        if run_seconds >= RESTART_SECONDS_MAX:
            self._backoff = RESTART_SECONDS_MIN
        wait = self._backoff * (0.5 + random.random())
        self._backoff = min(2 * self._backoff, RESTART_SECONDS_MAX)
        self.start_at = now + wait
        self.restarts += 1
        self.last_end = cause
        self.state = "restarting"
        self.reason = cause
        log.warning("%s: %s; restarting in %.1f s", self.name, cause, wait)


class CameraProcess(ChildProcess):
    """Process of one camera."""

    def __init__(self, camera: str, settings: CameraSettings) -> None:
        super().__init__(f"camera {camera}", HUNG_SECONDS, STOP_SECONDS)
        self.camera = camera
        self.settings = settings

    @property
    def silent(self) -> bool:
        """Return True if no process has said anything since its start."""
        return self.process is None or not self._has_reported

    def restart(self, settings: CameraSettings, now: float) -> None:
        """Restart the process with other settings."""
        self.settings = settings
        self._backoff = RESTART_SECONDS_MIN
        self.request_end(now, start_at=now)

    def summary(self) -> dict[str, Any]:
        """Return the status for ``status/{camera}`` while no process publishes it."""
        return camera_status(self.camera, self.state, self.reason, self.restarts, self.last_end)

    def _hear(self, lines: Sequence[str]) -> None:
        if (heartbeat := state_of(lines)) is not None:
            self._has_reported = True
            self.state, self.reason = heartbeat

    def _ended(self, status: int, now: float) -> None:
        has_begun = self.state in ("running", "blind", "ended")
        if self._asked_to_end or status == exits.USAGE:
            super()._ended(status, now)
        elif status == exits.DONE and self.state == "ended":  # a file; a stream never ends
            log.info("%s has ended", self.name)
        elif has_begun and kind_of(self.settings.source) == "file":
            self.status = status if status >= 0 else exits.FAILED
            cause = self._hang or exit_reason(status)
            self._give_up(f"{cause}; not restarted, as the events of a file would count twice")
        else:
            super()._ended(status, now)
