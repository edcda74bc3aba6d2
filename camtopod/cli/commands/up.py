"""`camtopod up`: the daemon, the grabbers and the page of one machine, in one terminal.

Daemon, page and bridge are processes beside those of the cameras. This one supervises all of them:
one that ends or hangs is started again, and hurts no other. Where only the user can help (status 2,
74 or 78), all ends.
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import sys
import threading
import time
from typing import Any

from camtopod.cli import exits
from camtopod.cli.cameras.camera_process import ChildProcess, exit_reason
from camtopod.cli.cameras.supervisor import common_options, supervise
from camtopod.cli.commands import web
from camtopod.cli.common import PARTS, configuration, signals, start_logging
from camtopod.cli.events import broker_options
from camtopod.cli.exits import CommandError
from camtopod.serve.runtime import systemd

log = logging.getLogger(__name__)

PAGE_NEEDS = "starlette"
"""Package without which there is no page."""
START_SECONDS = 10.0
"""Longest time that the cameras wait for the daemon, which otherwise each of them would miss."""
HUNG_SECONDS = 60.0
"""A part without a notification for this long is restarted, as by WatchdogSec= of the services."""
STOP_SECONDS = 9.0
"""Time after which a part that was asked to end is killed; it ends by itself within 8 s."""
LOOK_SECONDS = 0.1
"""Interval at which the parts are looked at."""


def add_parser(add: Any) -> None:
    """Add `up`."""
    parser = add(
        description="Runs the daemon, the grabbers of all configured cameras and the page on this "
        "machine until Ctrl-C: `run`, `grab` and `web` in one. What fails is tried again, unless "
        "its options, the configuration or the state directory are at fault. Cameras without a "
        "source get their events from other programs. SIGHUP reloads the cameras' settings.",
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
    """Run all parts until SIGTERM or SIGINT. Raises `CommandError` if one can never go on."""
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
                    while not requests.stop.wait(LOOK_SECONDS):
                        if requests.reload.is_set():
                            requests.reload.clear()
                            log.warning("no camera runs here: a change needs a restart")
        finally:
            parts.end()
        if parts.failure is not None:
            raise parts.failure


class _Part(ChildProcess):
    """Process of the daemon, the page or the bridge, as a service of which this one is the manager.

    Ctrl-C is not for it, but for this process, which ends the cameras first.
    """

    given_up = frozenset({exits.USAGE, exits.STATE, exits.CONFIG})

    def __init__(self, args: argparse.Namespace, command: str, *options: str) -> None:
        super().__init__(PARTS[command], HUNG_SECONDS, STOP_SECONDS, process_group=0)
        self.command = [sys.executable, "-m", "camtopod", *common_options(args), command, *options]


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
            part.request_end(time.monotonic())
        while not all(part.over for part in self._parts):
            self._look_after()
            time.sleep(LOOK_SECONDS)

    def _watch(self) -> None:
        """Look after all parts until the end, which one that is given up is for all."""
        while not self._stop.wait(LOOK_SECONDS):
            self._look_after()
            for part in self._parts:
                if part.over:
                    words = f"{part.name}: {exit_reason(part.status)}, see above"
                    self.failure = CommandError(f"{words}; all has been stopped", part.status)
                    self._stop.set()
                    return
            if not self._ready.is_set() and self._parts[0].state == "running":
                self._ready.set()
                self._parts += self._readers()

    def _look_after(self) -> None:
        for part in self._parts:
            part.look_after(time.monotonic(), part.command)

    def _readers(self) -> list[_Part]:
        """Return page and bridge, which look for the daemon once, at each start."""
        args = self._args
        parts = []
        if importlib.util.find_spec(PAGE_NEEDS) is None:
            log.warning(
                "there is no page: pip install 'camtopod[web]' (in a clone '.[web]') adds it"
            )
        else:
            options = [option for name in args.name for option in ("--name", name)]
            options += ["--listen", args.listen] if args.listen else []
            parts.append(_Part(args, "web", *options))
        if args.bridge:
            password = ["--password-file", str(args.password_file)] if args.password_file else []
            authorities = ["--ca", args.ca] if args.ca else []
            parts.append(_Part(args, "bridge", args.bridge, *password, *authorities))
        return parts
