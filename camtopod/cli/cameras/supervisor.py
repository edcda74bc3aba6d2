"""Supervisor of all cameras of a configuration, one process per camera.

A process that fails or hangs is restarted and affects no other camera.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time
from collections.abc import Sequence

from camtopod.cli import exits
from camtopod.cli.cameras.camera_process import STOP_SECONDS, CameraProcess
from camtopod.cli.cameras.daemon_reach import DaemonReachLog
from camtopod.cli.cameras.status_reporter import StatusReporter
from camtopod.cli.common import SignalRequests, configuration_and_text
from camtopod.cli.exits import CommandError
from camtopod.config import CameraSettings, Config, without_source
from camtopod.serve.runtime import systemd

log = logging.getLogger(__name__)

_LOOK_SECONDS = 0.1
"""Interval at which the processes are checked."""
_SPEAK_SECONDS = 0.5
"""Interval at which the statuses of silent cameras are updated."""
_OF_ALL = ("site", "bus", "state", "limits")
"""Tables that every camera's process reads: a change restarts all cameras.

A change of ``[vision]`` restarts those whose own table does not override it.
"""


def supervise(args: argparse.Namespace, config: Config, text: bytes, told: SignalRequests) -> int:
    """Run `camtopod grab` for every camera until all have ended or a signal arrives.

    Returns the worst exit status. ``text`` is the content of the configuration; each process gets
    it from here, so that none reads a file that has been changed since but not accepted yet. Raises
    `CommandError` if a camera has no source.
    """
    _require_sources(config, text, args)
    site = _Cameras(args, config, text)
    try:
        while not told.stop.is_set() and not site.over:
            if told.reload.is_set():
                told.reload.clear()
                systemd.reloading()
                site.reload()
            site.look_after()
            told.stop.wait(_LOOK_SECONDS)
    finally:
        closed = site.end()
    status = exits.DONE if told.stop.is_set() else site.status
    if not closed:  # a bus that was not closed would keep the process from ending
        os._exit(status)
    return status


class _Cameras:
    """Processes of all cameras, and what is reported about them."""

    def __init__(self, args: argparse.Namespace, config: Config, text: bytes) -> None:
        self._args, self._config = args, config
        self._config_fd = _in_memory(text)
        self._children = {
            name: CameraProcess(name, _filled(config, name), config.health)
            for name in config.cameras
        }
        self._leaving: list[CameraProcess] = []
        self._speaker = StatusReporter(config)
        self._reach = DaemonReachLog()
        self._next_word = self._next_feeding = 0.0
        self._summary = ""

    @property
    def over(self) -> bool:
        """Return True if all processes have ended and none is to be restarted."""
        return all(child.over for child in [*self._children.values(), *self._leaving])

    @property
    def status(self) -> int:
        """Return the worst exit status."""
        return max((child.status for child in self._children.values()), default=0)

    def look_after(self) -> None:
        """Check every process once; never waits for a camera."""
        for child in [*self._leaving, *self._children.values()]:
            child.look_after(time.monotonic(), self._command, self._config_fd)
        self._leaving = [child for child in self._leaving if not child.over]

        # Log whether the daemon is reached.
        now = time.monotonic()
        known = {name: child.daemon for name, child in self._children.items()}
        self._reach.tell({name: why for name, why in known.items() if why is not None}, now)

        # Publish the status of cameras whose process cannot.
        if now >= self._next_word:
            self._next_word = now + _SPEAK_SECONDS
            silent = [child for child in self._children.values() if child.silent]
            self._speaker.say(
                {
                    child.camera: child.summary(now)
                    for child in silent
                    if child.restarts or child.over
                }
            )

        # Report to systemd.
        if now >= self._next_feeding:
            self._next_feeding = now + systemd.feed_seconds()
            systemd.notify("WATCHDOG=1")
        self._tell_systemd(now)

    def reload(self) -> None:
        """Reload the configuration.

        Changed cameras restart, removed ones end, new ones start, and the others are not touched.
        """
        try:
            config, text = configuration_and_text(self._args)
            _require_sources(config, text, self._args)
        except CommandError as error:
            log.error("the old configuration stays in use: %s", " ".join(str(error).splitlines()))
            self._summary = ""
            return

        # Switch to the new configuration.
        now = time.monotonic()
        old, self._config = self._config, config
        os.close(self._config_fd)
        self._config_fd = _in_memory(text)
        every = any(getattr(old, table) != getattr(config, table) for table in _OF_ALL)

        # End the removed cameras.
        for name in [name for name in self._children if name not in config.cameras]:
            child = self._children.pop(name)
            child.request_end(now)
            self._leaving.append(child)

        # Start new cameras, restart changed ones.
        started: list[str] = []
        anew: list[str] = []
        ending = {child.camera: child for child in self._leaving}
        for name in config.cameras:
            camera = _filled(config, name)
            known = self._children.get(name)
            child = known or ending.pop(name, None) or CameraProcess(name, camera, config.health)
            changed = known is None or every or child.settings != camera
            if changed:
                (started if known is None else anew).append(name)
            child.renew(camera, config.health, now, changed)
            self._children[name] = child
        self._leaving = list(ending.values())

        # Publish statuses on the new bus.
        if (old.site, old.bus) != (config.site, config.bus):
            self._speaker.close()
            self._speaker = StatusReporter(config)

        # Log what happens.
        gone = [child.camera for child in self._leaving]
        log.info(
            "the configuration is reloaded; cameras started: %s; restarted: %s; ended: %s",
            *(", ".join(names) or "none" for names in (started, anew, gone)),
        )
        self._summary = ""

    def end(self) -> bool:
        """End all processes, killing those that do not end in time.

        Returns False if the bus blocks and is left open.
        """
        systemd.notify("STOPPING=1")
        everyone = [*self._children.values(), *self._leaving]
        for child in everyone:
            child.request_end(time.monotonic())
        deadline = time.monotonic() + STOP_SECONDS + 1.0
        while not all(child.over for child in everyone) and time.monotonic() < deadline:
            for child in everyone:
                child.look_after(time.monotonic(), self._command, self._config_fd)
            time.sleep(_LOOK_SECONDS / 5)
        os.close(self._config_fd)
        return self._speaker.close()

    def _tell_systemd(self, now: float) -> None:
        """Report to `systemctl status` how many cameras run, and the state of the others."""
        running = sum(child.state == "running" for child in self._children.values())
        wrong = [
            f"{child.camera}: {child.state}"
            for child in self._children.values()
            if child.state != "running"
        ]
        summary = f"{running} of {len(self._children)} cameras run" + "".join(
            f"; {one}" for one in wrong[:10]
        )
        if summary != self._summary:
            self._summary = summary
            systemd.notify("READY=1", systemd.status(summary))

    def _command(self, camera: str, restarts: int, last_end: str, beat_fd: int) -> Sequence[str]:
        """Return the command line of a camera's process."""
        return command(camera, self._args, self._config_fd, restarts, last_end, beat_fd)


def command(
    camera: str,
    args: argparse.Namespace,
    config_fd: int,
    restarts: int,
    last_end: str,
    beat_fd: int,
) -> list[str]:
    """Return the command line of a camera's process; it contains no source, so no password."""
    line = [
        sys.executable,
        "-m",
        "camtopod",
        "--config",
        str(args.config),
        "--log-format",
        args.log_format,
    ]
    if (level := getattr(args, "log_level", "info")) != "info":
        line += ["--log-level", level]
    if args.site is not None:
        line += ["--site", args.site]
    for endpoint in args.connect:
        line += ["--connect", endpoint]
    line += ["grab", "--camera", camera, "--with-parent", str(os.getpid())]
    line += ["--config-fd", str(config_fd), "--beat-fd", str(beat_fd)]
    if restarts:
        line += ["--restarts", str(restarts), "--last-end", last_end]
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


def _require_sources(config: Config, text: bytes, args: argparse.Namespace) -> None:
    """Raise `CommandError`, with file and line, if cameras of the configuration have no source."""
    if missing := without_source(config, text.decode(), args.config):
        raise CommandError("\n".join(missing), exits.CONFIG)


def _in_memory(text: bytes) -> int:
    """Return a descriptor of ``text``, readable any number of times through /proc/self/fd/N."""
    fd = os.memfd_create("camtopod.toml", os.MFD_CLOEXEC)
    with open(fd, "wb", closefd=False) as out:
        out.write(text)
    return fd
