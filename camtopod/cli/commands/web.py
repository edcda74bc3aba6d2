"""`camtopod web`: the page."""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import ipaddress
import logging
import os
import re
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from camtopod.cli import descriptors, exits
from camtopod.cli.common import configuration, leaving, start_logging, until_signal, watched
from camtopod.cli.exits import CommandError
from camtopod.serve.bus import BusError, dial
from camtopod.serve.runtime import Progress, clock

log = logging.getLogger(__name__)

LISTEN = "127.0.0.1:8780"
LEAVE_SECONDS = 5.0
_LOOK_SECONDS = 1.0


def add_parser(subparsers: Any) -> None:
    """Add `web`."""
    parser = subparsers.add_parser(
        "web",
        help="the page: map, cameras, links, versions and health in a browser",
        description="Shows what the daemon has learned, and predictions as they come, in a browser. It only reads. "
        "Nothing is loaded from elsewhere.",
    )
    parser.add_argument(
        "--listen",
        metavar="HOST:PORT",
        default=LISTEN,
        help=f"where (default: {LISTEN}, this machine only; port 0: a free one)",
    )
    parser.add_argument(
        "--name",
        metavar="NAME",
        action="append",
        default=[],
        help="a further name that it is asked for by, behind a proxy say (addresses need none; repeat for several)",
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        type=Path,
        help="a folder of this machine with a picture a camera, CAMERA.jpg or CAMERA.png (`camtopod init --pictures` "
        "makes them; for cameras of other machines copy theirs)",
    )


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT."""
    start_logging(args)
    faulthandler.enable(file=2)  # systemd's watchdog ends what hangs with SIGABRT
    descriptors.raise_limit()
    try:
        from camtopod.web import app
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn"):
            raise
        raise CommandError(
            "the page needs starlette and uvicorn: pip install 'camtopod[web]'"
        ) from None
    config = configuration(args)
    host, port = address(args.listen)
    if args.pictures is not None and not os.access(args.pictures, os.R_OK | os.X_OK):
        why = "this user may not read it" if args.pictures.exists() else "there is no such folder"
        log.warning("--pictures %s: %s; cameras have no picture yet", args.pictures, why)
    with until_signal() as stop, leaving(stop, LEAVE_SECONDS), contextlib.ExitStack() as stack:
        listener = stack.enter_context(listening(host, port))
        try:
            bus = stack.enter_context(dial(config))
        except BusError as error:
            raise CommandError(str(error), exits.BUS) from None
        every, progress = config.limits.status_seconds, Progress()
        running = stack.enter_context(
            app.serving(
                bus,
                listener,
                names(host, args.name),
                args.pictures,
                clock.wall,
                every,
                not is_loopback(host),
                progress,
                config.health.stall_seconds,
            )
        )
        stack.enter_context(watched(progress, f"the page is at http://{_shown(listener)}/"))
        log.info("the page is at http://%s/", _shown(listener))
        if not is_loopback(host):
            log.warning(
                "anybody who reaches %s can read it: there is no password", _shown(listener)
            )
        while not stop.wait(_LOOK_SECONDS):
            if not running():  # its traceback has been written
                raise CommandError("a part of the page's server has failed")
    return exits.DONE


def address(text: str) -> tuple[str, int]:
    """HOST:PORT, ``[::1]:8780`` for IPv6. Raises `CommandError`."""
    match = re.fullmatch(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):([0-9]{1,5})", text)
    if match is None or int(match[2]) > 65535:
        raise CommandError(
            f"--listen {text!r}: write it like {LISTEN} or 0.0.0.0:8780", exits.USAGE
        )
    return match[1].strip("[]"), int(match[2])


def names(host: str, further: Sequence[str] = ()) -> list[str]:
    """Names to answer to: else the page of another site could read this one through a name that
    leads here.
    """
    ours = ["localhost", "127.0.0.1", "[::1]", host, *further]
    return (
        ours
        if is_loopback(host)
        else [*ours, socket.gethostname(), f"{socket.gethostname()}.local"]
    )


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches ``host``."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def listening(host: str, port: int) -> socket.socket:
    """A socket that listens there. Raises `CommandError`."""
    try:
        return socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
    except OSError as error:
        raise CommandError(
            f"--listen {host}:{port}: {error.strerror}; choose another port, or 0"
        ) from None


def _shown(listener: socket.socket) -> str:
    host, port = listener.getsockname()[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
