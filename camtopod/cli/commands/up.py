"""`camtopod up`: the daemon, the grabbers and the page of one machine, in one terminal.

Daemon, page and bridge are processes beside those of the cameras, which this one supervises as
`grab` does. A camera's process is started again; when another one ends, all end.
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any

from camtopod.cli import exits
from camtopod.cli.cameras.camera_process import exit_reason
from camtopod.cli.cameras.heartbeat import HeartbeatReceiver
from camtopod.cli.cameras.supervisor import common_options, supervise
from camtopod.cli.commands import web
from camtopod.cli.common import PARTS, configuration, signals, start_logging
from camtopod.cli.events import broker_options
from camtopod.cli.exits import CommandError
from camtopod.serve.runtime import SOCKET_VARIABLE, systemd

log = logging.getLogger(__name__)

PAGE_NEEDS = "starlette"
"""Package without which there is no page."""
START_SECONDS = 10.0
"""Longest time that the cameras wait for the daemon, which otherwise each of them would miss."""
HUNG_SECONDS = 60.0
"""A part without a notification for this long is ended, as by WatchdogSec= of the services."""
STOP_SECONDS = 9.0
"""Time after which a part that was asked to end is killed; it ends by itself within 8 s."""
LOOK_SECONDS = 0.1
"""Interval at which the parts are looked at."""


def add_parser(add: Any) -> None:
    """Add `up`."""
    parser = add(
        description="Runs the daemon, the grabbers of all configured cameras and the page on this "
        "machine until Ctrl-C or until one of them cannot go on: `run`, `grab` and `web` in one. A "
        "camera that fails is tried again. Cameras without a source get their events from other "
        "programs. SIGHUP reloads the cameras' settings.",
        epilog="example: camtopod init lobby=rtsp://192.0.2.10/stream1 && camtopod up",
    )
    web.add_address(parser)
    parser.add_argument(
        "--state",
        metavar="DIRECTORY",
        help="directory of journal and spools (default: [state] directory)",
    )
    parser.add_argument(
        "--bridge",
        metavar="URL",
        help="also run the bridge to Home Assistant, through the broker at this URL",
    )
    broker_options.add_options(parser)
    parser.set_defaults(start=0.0, realtime=False)  # as of `grab`


def run(args: argparse.Namespace) -> None:
    """Run all parts until SIGTERM or SIGINT. Raises `CommandError` when one cannot go on."""
    start_logging(args)
    with signals() as requests:
        config = configuration(args)
        if args.config is None and args.config_found:
            raise CommandError(
                "there is no configuration here: `camtopod init lobby=rtsp://...` makes one of "
                "your cameras; --config none does without cameras",
                exits.USAGE,
            )
        log.info("starting the daemon, then grabbers and page; Ctrl-C ends all")
        parts = _Parts(args, requests.stop)
        try:
            parts.start()
            cameras = config.grabbed.cameras
            if cameras and not requests.stop.is_set():
                supervise(args, config.grabbed, requests)
            if not requests.stop.is_set():
                words = "no camera runs any more" if cameras else "no camera is grabbed here"
                log.info("%s; daemon and page go on", words)
                systemd.notify("READY=1")
                with systemd.watchdog(lambda: [], lambda: False):
                    requests.stop.wait()
        finally:
            parts.end()
        if parts.failure is not None:
            raise parts.failure


class _Part:
    """Process of the daemon, the page or the bridge, with what it tells of itself."""

    def __init__(self, args: argparse.Namespace, command: str, *options: str) -> None:
        """Start it, as a service of which this process is the manager."""
        line = [sys.executable, "-m", "camtopod", *common_options(args), command, *options]
        self.name = PARTS[command]
        self.ready = False
        self._heard_at = time.monotonic()
        self._receiver = HeartbeatReceiver()
        environment = {**os.environ, SOCKET_VARIABLE: self._receiver.address}
        environment.pop("WATCHDOG_USEC", None)
        self.process = subprocess.Popen(
            line,
            stdin=subprocess.DEVNULL,
            env=environment,
            process_group=0,  # Ctrl-C is for this process, which ends the cameras first
        )

    def look(self) -> tuple[str, int]:
        """Read its notifications; return why it cannot go on, or "", and the exit status then."""
        if lines := self._receiver.lines():
            self._heard_at = time.monotonic()
            self.ready |= "READY=1" in lines
        status = self.process.poll()
        if status is not None:  # ended by somebody else, it has failed as well
            return exit_reason(status), max(status, exits.FAILED)
        if time.monotonic() - self._heard_at > HUNG_SECONDS:
            self.process.send_signal(signal.SIGABRT)  # it logs where it hangs
            return f"hung for {HUNG_SECONDS:.0f} s", exits.FAILED
        return "", exits.DONE

    def end(self, deadline: float) -> None:
        """Wait until it has ended, and kill it at the deadline (monotonic, seconds)."""
        try:
            self.process.wait(max(deadline - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._receiver.close()


class _Parts:
    """The processes beside the cameras', and a thread that watches them."""

    def __init__(self, args: argparse.Namespace, stop: threading.Event) -> None:
        self._args = args
        self._stop = stop
        self._parts: list[_Part] = []
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="parts", daemon=True)
        self.failure: CommandError | None = None
        """Why all end, unless by a signal."""

    def start(self) -> None:
        """Start the daemon, and wait for it for a while; the others start once it is ready."""
        state = ["--state", self._args.state] if self._args.state else []
        self._parts.append(_Part(self._args, "run", *state))
        self._thread.start()
        deadline = time.monotonic() + START_SECONDS
        while not self._ready.is_set() and time.monotonic() < deadline:
            if self._stop.wait(LOOK_SECONDS):
                return

    def end(self) -> None:
        """End all, killing those that do not end in time."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()
        for part in self._parts:
            part.process.terminate()
        deadline = time.monotonic() + STOP_SECONDS
        for part in self._parts:
            part.end(deadline)

    def _watch(self) -> None:
        """Look at all parts until the end; the first that ends ends all."""
        while not self._stop.wait(LOOK_SECONDS):
            for part in self._parts:
                reason, status = part.look()
                if reason:
                    words = f"{part.name}: {reason}, see above; all has been stopped"
                    self.failure = CommandError(words, status)
                    self._stop.set()
                    return
            if not self._ready.is_set() and self._parts[0].ready:
                self._ready.set()
                self._parts += self._readers()

    def _readers(self) -> list[_Part]:
        """Start page and bridge, which look for the daemon once."""
        args = self._args
        parts = []
        if importlib.util.find_spec(PAGE_NEEDS) is None:
            log.warning(
                "there is no page: pip install 'camtopod[web]' (in a clone '.[web]') adds it"
            )
        else:
            names = [option for name in args.name for option in ("--name", name)]
            parts.append(_Part(args, "web", "--listen", args.listen, *names))
        if args.bridge:
            password = ["--password-file", str(args.password_file)] if args.password_file else []
            authorities = ["--ca", args.ca] if args.ca else []
            parts.append(_Part(args, "bridge", args.bridge, *password, *authorities))
        return parts
