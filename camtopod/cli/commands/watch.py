"""`camtopod watch`: show cameras, topology and predictions live in the terminal.

With rich, an extra (``[terminal]``), they fill the screen of a terminal; else they are printed as
lines, again and again.
"""

from __future__ import annotations

import argparse
import logging
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import configuration, start_logging, until_signal
from camtopod.cli.site_choice import dial_as_reader
from camtopod.cli.terminal import (
    LINKS_SHOWN,
    SiteState,
    alarm_lines,
    busiest_links,
    topology_lines,
    transit,
)
from camtopod.records import Topology
from camtopod.serve.bus import TopologySubscriber
from camtopod.serve.runtime import clock
from camtopod.visible import visible

REFRESH_SECONDS = 0.5
"""Interval between two views."""


def add_parser(subparsers: Any) -> None:
    """Add `watch`."""
    parser = subparsers.add_parser(
        "watch",
        help="show cameras, topology and predictions live in the terminal",
        description="Shows cameras, the learned topology and predictions as they arrive, until "
        "interrupted.",
        epilog="example: camtopod --site hq watch",
    )
    parser.add_argument("--once", action="store_true", help="show the state once and end")
    parser.add_argument(
        "--plain",
        action="store_true",
        help="show plain lines of text, even if rich ([terminal]) is installed",
    )


def run(args: argparse.Namespace) -> int:
    """Show the site until SIGTERM or SIGINT."""
    start_logging(args)
    config = configuration(args)
    bus, config = dial_as_reader(args, config)
    site = SiteState(config.site.name)
    with bus, until_signal() as stop:
        # Subscribe first, then ask for the newest statuses.
        bus.subscribe("status/*", site.on_status)
        bus.subscribe("prediction/*", site.on_prediction)
        subscriber = TopologySubscriber(bus)
        for key, payload in bus.query("status/*"):
            site.on_status(key, payload)

        def view(rows: int | None = None) -> list[str]:
            subscriber.update()
            return lines(site, subscriber.topology, clock.wall(), rows)

        if args.once:
            until = time.monotonic() + 3.0
            while site.empty and time.monotonic() < until and not stop.wait(REFRESH_SECONDS / 2):
                pass
            print("\n".join(view()), flush=True)
        elif args.plain or not (sys.stdout.isatty() and on_screen(view, stop)):
            while not stop.is_set():
                print("\n".join(view()), flush=True)
                stop.wait(REFRESH_SECONDS)
    return exits.DONE


def on_screen(view: Callable[[int], list[str]], stop: threading.Event) -> bool:
    """Draw with rich until ``stop``; return False at once if rich is missing or cannot draw here.

    view: returns the lines of a screen with that many rows.
    """
    try:
        from rich.console import Console
        from rich.live import Live
        from rich.text import Text
    except ModuleNotFoundError:
        return False
    console = Console()
    if console.is_dumb_terminal:
        return False

    logging.disable()  # messages would disturb the screen
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while not stop.is_set():
                text = Text(no_wrap=True, overflow="ellipsis")
                for line in view(console.height):
                    text.append(line + "\n", style="bold yellow" if line.startswith("!") else "")
                live.update(text, refresh=True)
                stop.wait(REFRESH_SECONDS)
    finally:
        logging.disable(logging.NOTSET)
    return True


def lines(site: SiteState, topology: Topology | None, now: float, rows: int | None) -> list[str]:
    """Return the whole view as lines; control sequences in others' texts are made visible.

    now: Unix seconds.
    rows: of the screen; then cameras without problems and the least used links are left out so
    that every part has some of them. None: all cameras.
    """
    alarms = alarm_lines(topology, now)
    if alarms:
        alarms = ["ALARMS", *alarms, ""]
    head = [site.daemon_line(), *topology_lines(topology), "", *alarms]
    part = None
    if rows is not None:
        part = max(4, (rows - len(head) - 3) // 3)
    text = [
        *head,
        *_cut(_cameras(site, topology, now), part),
        "",
        *_cut(_links(topology), part),
        "",
        "PREDICTIONS",
        *site.prediction_lines(),
    ]
    return [visible(line) for line in text]


def _cut(table: list[str], rows: int | None) -> list[str]:
    """Return at most ``rows`` rows of a table; the last one says how many are left out."""
    if rows is None or len(table) <= rows:
        return table
    return [*table[: rows - 1], f"... and {len(table) - rows + 1} more"]


def _cameras(site: SiteState, topology: Topology | None, now: float) -> list[str]:
    """Return the table of cameras; those with problems come first, with an exclamation mark."""
    rows = [f"  {'CAMERA':<20} {'STATE':<11} {'EVENTS':>8} {'LAST':>9}  REASON"]
    for camera in site.cameras(topology, now):
        mark = "!" if camera.wrong else " "
        last = "" if camera.last is None else f"{camera.last:.0f} s"
        rows.append(
            f"{mark} {camera.name:<20} {camera.state:<11} {camera.events:>8} {last:>9}"
            f"  {camera.reason}"
        )
    return rows


def _links(topology: Topology | None) -> list[str]:
    """Return the table of links."""
    links = busiest_links(topology)
    rows = [
        f"  {'FROM':<20} {'TO':<20} {'RELATION':<10} {'SHARE':>6} {'TRANSIT (q10 to q90)':>23}",
        *(
            f"  {link.from_:<20} {link.to:<20} {link.relation:<10} "
            f"{link.probability:>6.2f} {transit(link):>23}"
            for link in links
        ),
    ]
    return _cut(rows, LINKS_SHOWN + 1)
