"""Supervisor of all cameras of a configuration, one process per camera.

A process that fails or hangs is restarted and affects no other camera.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time

from camtopod.cli import exits
from camtopod.cli.cameras.camera_process import STOP_SECONDS, CameraProcess
from camtopod.cli.cameras.status_reporter import StatusReporter
from camtopod.cli.common import SignalRequests, configuration
from camtopod.cli.exits import CommandError
from camtopod.config import CameraSettings, Config, without_source
from camtopod.serve.runtime import systemd

log = logging.getLogger(__name__)

_OF_ALL = ("site", "bus", "state", "limits")
"""Tables that every camera's process reads: a change restarts all cameras.

A change of ``[vision]`` restarts those whose own table does not override it.
"""


def supervise(args: argparse.Namespace, config: Config, requests: SignalRequests) -> int:
    """Run `camtopod grab` for every camera until all have ended or a signal arrives.

    Returns the worst exit status. Raises `CommandError` if a camera has no source.
    """
    _require_sources(config, args)
    supervisor = _Supervisor(args, config)
    try:
        while not requests.stop.is_set() and not supervisor.over:
            if requests.reload.is_set():
                requests.reload.clear()
                systemd.reloading()
                supervisor.reload()
            supervisor.look_after()
            requests.stop.wait(0.1)
    finally:
        closed = supervisor.end()
    status = exits.DONE if requests.stop.is_set() else supervisor.status
    if not closed:  # a bus that was not closed would keep the process from ending
        os._exit(status)
    return status


class _Supervisor:
    """Processes of all cameras, and their status reports."""

    def __init__(self, args: argparse.Namespace, config: Config) -> None:
        self._args = args
        self._config = config
        self._processes = {
            name: CameraProcess(name, _filled(config, name)) for name in config.cameras
        }
        """Those of removed cameras are included until they have ended."""
        self._reporter = StatusReporter(config)
        self._report_at = 0.0

    @property
    def over(self) -> bool:
        """Return True if all processes have ended and none is to be restarted."""
        return all(process.over for process in self._processes.values())

    @property
    def status(self) -> int:
        """Return the worst exit status."""
        return max((process.status for process in self._processes.values()), default=0)

    def look_after(self) -> None:
        """Check every process once; never waits for a camera."""
        now = time.monotonic()
        for process in self._processes.values():
            process.look_after(now, self._command)
        for name in self._processes.keys() - self._config.cameras.keys():
            if self._processes[name].over:
                del self._processes[name]
        if now >= self._report_at:
            self._report_at = now + min(0.5, systemd.feed_seconds())
            self._report(now)

    def reload(self) -> None:
        """Reload the configuration.

        Changed cameras restart, removed ones end, new ones start, and the others are not touched.
        """
        try:
            config = configuration(self._args)
            _require_sources(config, self._args)
        except CommandError as error:
            log.error("the old configuration stays in use: %s", " ".join(str(error).splitlines()))
            return
        old = self._config
        self._config = config

        # Restart or start cameras.
        now = time.monotonic()
        every = any(getattr(old, table) != getattr(config, table) for table in _OF_ALL)
        started = []
        restarted = []
        for name in config.cameras:
            settings = _filled(config, name)
            process = self._processes.get(name)
            if process is None:
                self._processes[name] = CameraProcess(name, settings)
                started.append(name)
                continue
            if every or name not in old.cameras or process.settings != settings:
                process.restart(settings, now)
                restarted.append(name)

        # End removed cameras.
        ended = sorted(self._processes.keys() - config.cameras.keys())
        for name in ended:
            self._processes[name].request_end(now)

        if (old.site, old.bus) != (config.site, config.bus):
            self._reporter.close()
            self._reporter = StatusReporter(config)
        log.info(
            "the configuration is reloaded; cameras started: %s; restarted: %s; ended: %s",
            *(", ".join(names) or "none" for names in (started, restarted, ended)),
        )

    def end(self) -> bool:
        """End all processes, killing those that do not end in time.

        Returns False if the bus blocks and is left open.
        """
        systemd.notify("STOPPING=1")
        for process in self._processes.values():
            process.request_end(time.monotonic())
        deadline = time.monotonic() + STOP_SECONDS + 1.0
        while not self.over and time.monotonic() < deadline:
            for process in self._processes.values():
                process.look_after(time.monotonic(), self._command)
            time.sleep(0.1 / 5)
        return self._reporter.close()

    def _report(self, now: float) -> None:
        """Publish the statuses of cameras whose processes cannot, and report to systemd."""
        self._reporter.publish(
            {
                process.camera: process.summary(now)
                for process in self._processes.values()
                if process.silent and (process.restarts or process.over)
            }
        )
        others = [
            f"; {process.camera}: {process.state}"
            for process in self._processes.values()
            if process.state != "running"
        ]
        running = len(self._processes) - len(others)
        summary = f"{running} of {len(self._processes)} cameras run{''.join(others[:10])}"
        systemd.notify("READY=1", "WATCHDOG=1", systemd.status(summary))

    def _command(self, process: CameraProcess, heartbeat_fd: int) -> list[str]:
        """Return the command line of a camera's process."""
        return command(process, self._args, heartbeat_fd)


def command(process: CameraProcess, args: argparse.Namespace, heartbeat_fd: int) -> list[str]:
    """Return the command line of a camera's process; it contains no source, so no password."""
    line = [sys.executable, "-m", "camtopod", "--config", str(args.config)]
    line += ["--log-format", args.log_format, "--log-level", getattr(args, "log_level", "info")]
    if args.site is not None:
        line += ["--site", args.site]
    for endpoint in args.connect:
        line += ["--connect", endpoint]
    line += ["grab", "--camera", process.camera, "--with-parent", str(os.getpid())]
    line += ["--beat-fd", str(heartbeat_fd), "--restarts", str(process.restarts)]
    line += ["--last-end", process.last_end]
    for option in ("state", "start", "speed"):
        if getattr(args, option) is not None:
            line += [f"--{option}", str(getattr(args, option))]
    return line + (["--realtime"] if args.realtime else [])


def _filled(config: Config, camera: str) -> CameraSettings:
    """Return the camera's settings with its source, which may be in a file, to notice changes."""
    try:
        return config.for_camera(camera).cameras[camera]
    except OSError:  # its own process reports this and tries again
        return config.cameras[camera]


def _require_sources(config: Config, args: argparse.Namespace) -> None:
    """Raise `CommandError`, with file and line, if cameras of the configuration have no source."""
    if missing := without_source(config, args.config.read_text("utf-8"), args.config):
        raise CommandError("\n".join(missing), exits.CONFIG)
