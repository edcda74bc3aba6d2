"""`camtopod run`: run the daemon."""

from __future__ import annotations

import argparse
import gc
import logging
import sys
from typing import Any

from camtopod.cli.common import SignalRequests, configuration, ends_within, signals, start_logging
from camtopod.cli.exits import CommandError
from camtopod.serve.bus import log_to_standard_output
from camtopod.serve.daemon import Daemon
from camtopod.serve.monitoring import health, metrics
from camtopod.serve.runtime import systemd

log = logging.getLogger(__name__)

LEAVE_SECONDS = 8.0
"""Time that a blocking part may delay the end after a signal; systemd kills at TimeoutStopSec=10.
"""
SWITCH_SECONDS = 0.0005
"""Longest time that a thread keeps the GIL while another waits for it.

The default of 5 ms would delay the prediction for an exit while events are being stored.
"""


def add_parser(add: Any) -> None:
    """Add `run`."""
    parser = add(
        description="Runs the daemon: it learns the topology from the events on the bus, publishes "
        "it and predicts. With no endpoint configured, all other programs of this machine connect "
        "to it.",
        epilog="example: camtopod --config camtopod.toml run",
    )
    parser.add_argument(
        "--state", metavar="DIRECTORY", help="directory of the journal (default: [state] directory)"
    )


def run(args: argparse.Namespace) -> None:
    """Run the daemon until SIGTERM or SIGINT."""
    gc.freeze()  # what was imported is never garbage
    sys.setswitchinterval(SWITCH_SECONDS)
    start_logging(args)

    # Load the configuration, then run with health page and watchdog.
    with signals() as requests, ends_within(requests.stop, LEAVE_SECONDS, args.with_parent):
        config = configuration(args)
        daemon = Daemon(config)
        log_to_standard_output()
        pages = {"/metrics": lambda: metrics.page(daemon, config.limits.cameras_max)}
        with (
            health.serving(config.health.listen, daemon.failing, daemon.unready, pages) as address,
            systemd.watchdog(daemon.failing, lambda: not daemon.started),
        ):
            if address:
                log.info("health at http://%s/healthz, /readyz and /metrics", address)
            systemd.notify(systemd.status("starting"))
            _run(daemon, requests)
    log.info("ended cleanly")


def _run(daemon: Daemon, requests: SignalRequests) -> None:
    """Start the daemon, and run it until a signal ends it or a part of it fails."""
    if not daemon.start(requests.stop):
        return
    try:
        systemd.notify("READY=1", systemd.status(f"running at {daemon.endpoint}"))
        while not requests.stop.wait(0.2):
            if daemon.wait(0):
                raise CommandError("a part of the daemon failed, see above; start it again")
            if requests.reload.is_set():
                requests.reload.clear()
                log.warning("SIGHUP changes nothing here: restart the daemon after a change")
    finally:
        systemd.notify("STOPPING=1")
        daemon.stop()
