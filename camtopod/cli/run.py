"""`camtopod run`: the daemon."""

from __future__ import annotations

import argparse
import logging
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import configuration, start_logging, until_signal
from camtopod.cli.exits import CommandError
from camtopod.serve.bus import BusError
from camtopod.serve.daemon import Daemon
from camtopod.serve.database import StateError

log = logging.getLogger(__name__)

_LOOK_SECONDS = 0.2


def add_parser(subparsers: Any) -> None:
    """Add `run`."""
    parser = subparsers.add_parser(
        "run",
        help="the daemon",
        description="Learns the topology from the events on the bus, publishes it and predicts. "
        "With no endpoint configured it is the meeting point for all other programs of this machine.",
    )
    parser.add_argument("--state", metavar="DIRECTORY", help="where the journal is kept (default: [state] directory)")


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM or SIGINT."""
    start_logging(args)
    daemon = Daemon(configuration(args))
    with until_signal() as stop:
        try:
            if not daemon.start(stop):
                return exits.DONE
        except StateError as error:
            raise CommandError(str(error), exits.STATE) from None
        except BusError as error:
            raise CommandError(str(error), exits.BUS) from None
        try:
            while not stop.wait(_LOOK_SECONDS):
                if daemon.wait(0):
                    raise CommandError("a part of the daemon has failed, see above; start it again")
        finally:
            daemon.stop()
    log.info("ended cleanly")
    return exits.DONE
