"""Supervisor of all cameras of a configuration, one process per camera.

A process that fails or hangs is restarted and affects no other camera.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import threading
import time

from camtopod.cli import exits
from camtopod.cli.cameras.camera_process import STOP_SECONDS, CameraProcess, site_status
from camtopod.cli.cameras.heartbeat import HeartbeatSender
from camtopod.cli.common import SignalRequests, configuration
from camtopod.cli.exits import CommandError
from camtopod.config import CameraSettings, Config, without_source
from camtopod.serve.outbox import spool_path
from camtopod.serve.runtime import systemd
from camtopod.serve.storage import lock_reason

log = logging.getLogger(__name__)

_OF_ALL = ("site", "sites", "bus", "state", "limits")
"""Tables that every camera's process reads: a change restarts all cameras.

A change of ``[vision]`` restarts those whose own table does not override it.
"""

_OF_CAMERAS = ("sites", "cameras", "vision", "detector")
"""Tables that no process of `up` reads but the cameras'."""


def supervise(args: argparse.Namespace, config: Config, requests: SignalRequests) -> int:
    """Run `camtopod grab` for every camera until all have ended or a signal arrives.

    Returns the worst exit status. Raises `CommandError` if a camera has no source, or a spool that
    another process holds.
    """
    _require_sources(config, args)
    for camera in config.cameras:
        if reason := lock_reason(spool_path(config.state_directory, config.site.name, camera)):
            raise CommandError(f"{camera}: {reason}", exits.STATE)
    supervisor = _Supervisor(args, config)
    try:
        while not requests.stop.is_set() and not supervisor.over:
            if requests.reload.is_set():
                requests.reload.clear()
                systemd.reloading()
                supervisor.reload()
            supervisor.look_after()
            requests.stop.wait(0.1)
        if requests.stop.is_set():
            return exits.DONE
        return max(process.status for process in supervisor.processes.values())
    finally:
        supervisor.end()


class _Supervisor:
    """Processes of all cameras, and a thread that publishes the status of those that do not run."""

    def __init__(self, args: argparse.Namespace, config: Config) -> None:
        self._args = args
        self._config = config
        self.processes = {
            name: CameraProcess(name, _filled(config, name)) for name in config.cameras
        }
        """Those of removed cameras are included until they have ended."""
        self._heartbeats = HeartbeatSender()
        self._ending = threading.Event()
        threading.Thread(target=self._publish, name="statuses", daemon=True).start()

    @property
    def over(self) -> bool:
        """Return True if all processes have ended and none is to be restarted."""
        return all(process.over for process in self.processes.values())

    def look_after(self) -> None:
        """Check every process once; never waits for a camera."""
        now = time.monotonic()
        for process in self.processes.values():
            process.look_after(now, command(process, self._args))
        for name in self.processes.keys() - self._config.cameras.keys():
            if self.processes[name].over:
                del self.processes[name]
        running_count = sum(process.state == "running" for process in self.processes.values())
        self._heartbeats.beat(f"{running_count} of {len(self.processes)} cameras run", "")

    def reload(self) -> None:
        """Reload the configuration.

        Changed cameras restart, removed ones end, new ones start, and the others are not touched.
        """
        try:
            config = configuration(self._args)
            if self._args.command == "up":
                config = config.grabbed
                self._require_same_place(config)
            _require_sources(config, self._args)
        except CommandError as error:
            log.error("the old configuration stays in use: %s", " ".join(str(error).splitlines()))
            return
        old = self._config
        self._config = config

        # Start, restart and end cameras.
        now = time.monotonic()
        common_change = any(getattr(old, table) != getattr(config, table) for table in _OF_ALL)
        for name in config.cameras:
            settings = _filled(config, name)
            process = self.processes.get(name)
            if process is None:
                self.processes[name] = CameraProcess(name, settings)
            elif common_change or name not in old.cameras or process.settings != settings:
                process.restart(settings, now)
        for name in self.processes.keys() - config.cameras.keys():
            self.processes[name].request_end(now)
        log.info("the configuration is reloaded, of %d cameras", len(config.cameras))

    def _require_same_place(self, config: Config) -> None:
        """Log changes that daemon and page miss; raise `CommandError` for one of all at once."""
        tables = [
            f"[{table}]"
            for table in config.__struct_fields__
            if table not in _OF_CAMERAS and getattr(self._config, table) != getattr(config, table)
        ]
        reason = f"a change of {', '.join(tables)} needs a restart of `camtopod up`"
        if not {"[site]", "[bus]", "[state]"}.isdisjoint(tables):
            raise CommandError(reason)
        if tables:
            log.warning("%s; the cameras go on with it", reason)

    def end(self) -> None:
        """End all processes, killing those that do not end in time."""
        systemd.notify("STOPPING=1")
        self._ending.set()
        for process in self.processes.values():
            process.request_end(time.monotonic())
        deadline = time.monotonic() + STOP_SECONDS + 1.0
        while not self.over and time.monotonic() < deadline:
            for process in self.processes.values():
                process.look_after(time.monotonic(), command(process, self._args))
            time.sleep(0.02)

    def _publish(self) -> None:
        """Publish the statuses of cameras whose processes cannot, until the end."""
        seconds = self._config.limits.status_seconds
        while not self._ending.wait(seconds):
            for process in list(self.processes.values()):
                if not process.silent or not (process.restarts or process.over):
                    continue
                from camtopod.serve.bus import dial  # takes memory, and is seldom needed

                camera = process.camera
                config = self._config.certified(camera)
                status = {**process.summary(), **site_status(config, camera)}
                for site in config.sites_of(camera):
                    try:
                        # On a session of its own: the camera may have a certificate of its own.
                        with dial(config.at(site)) as bus:
                            bus.publish(f"status/{camera}", status, "status")
                    except OSError as error:  # no bus, as the cameras' own processes report
                        log.debug("camera %s: its status is not published: %s", camera, error)


def command(process: CameraProcess, args: argparse.Namespace) -> list[str]:
    """Return the command line of a camera's process; it contains no source, so no password."""
    line = [sys.executable, "-m", "camtopod", *common_options(args)]
    line += ["grab", "--camera", process.camera]
    line += ["--restarts", str(process.restarts), "--last-end", process.last_end]
    line += ["--start", str(args.start)]
    if args.state is not None:
        line += ["--state", args.state]
    if args.realtime:
        line += ["--realtime"]
    return line


def common_options(args: argparse.Namespace) -> list[str]:
    """Return the common options of a process of this one, as this one was given them."""
    line = ["--config", str(args.config or "none")]
    line += ["--log-format", args.log_format, "--log-level", getattr(args, "log_level", "info")]
    if args.site is not None:
        line += ["--site", args.site]
    for endpoint in args.connect:
        line += ["--connect", endpoint]
    return [*line, "--with-parent", str(os.getpid())]


def _filled(config: Config, camera: str) -> CameraSettings:
    """Return the camera's settings with its source, which may be in a file, to notice changes."""
    try:
        return config.for_camera(camera).cameras[camera]
    except OSError:  # its own process reports this and tries again
        return config.cameras[camera]


def _require_sources(config: Config, args: argparse.Namespace) -> None:
    """Raise `CommandError`, with file and line, if cameras of the configuration have no source."""
    if problems := without_source(config, args.config.read_text("utf-8"), args.config):
        raise CommandError("\n".join(problems), exits.CONFIG)
