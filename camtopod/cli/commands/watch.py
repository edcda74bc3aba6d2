"""`camtopod watch`: show cameras, topology and predictions live in the terminal.

With rich, an extra (``[terminal]``), they fill the screen of a terminal; else they are printed as
lines, again and again.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from typing import Any

from camtopod.cli.common import configuration, start_logging, until_signal
from camtopod.cli.site_choice import add_districts, dial_sites
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
from camtopod.serve.city_bus import CityBus
from camtopod.serve.runtime import clock
from camtopod.topology import camera_of
from camtopod.visible import visible

log = logging.getLogger(__name__)

REFRESH_SECONDS = 0.5
"""Interval between two views."""


def add_parser(add: Any) -> None:
    """Add `watch`."""
    parser = add(
        description="Shows cameras, the learned topology and predictions as they arrive, until "
        "interrupted or, on the screen, q is pressed: on the whole screen with rich ([terminal]), "
        "else as lines. Several sites are one map, and lines have the site that owns the camera.",
        epilog="example: camtopod --site hq watch",
    )
    add_districts(parser)
    parser.add_argument("--once", action="store_true", help="show the state once and end")


def run(args: argparse.Namespace) -> None:
    """Show the site until SIGTERM or SIGINT."""
    start_logging(args)
    config = configuration(args)
    bus, config = dial_sites(args, config)
    site = SiteState(bus.site, owner=bus.owner if isinstance(bus, CityBus) else None)
    with bus, until_signal() as stop:
        # Subscribe first, then ask for the newest statuses.
        bus.subscribe("status/*", site.on_status)
        bus.subscribe("prediction/*", site.on_prediction)
        subscriber = bus if isinstance(bus, CityBus) else TopologySubscriber(bus)
        for key, payload in bus.query("status/*"):
            site.on_status(key, payload)

        def view() -> list[str]:
            subscriber.update()
            return parts(site, subscriber.topology, clock.wall())

        if args.once:
            print("\n\n".join(view()), flush=True)
        elif not (sys.stdout.isatty() and on_screen(view, stop)):
            while not stop.is_set():
                print("\n\n".join(view()), flush=True)
                stop.wait(REFRESH_SECONDS)


def on_screen(view: Callable[[], list[str]], stop: threading.Event) -> bool:
    """Draw with rich until ``stop``; return False at once if rich is missing or cannot draw here.

    view: returns the parts of the screen. The first has the room that it needs, the others share
    the rest.
    """
    try:
        from rich.console import Console
        from rich.layout import Layout
        from rich.live import Live
        from rich.text import Text
    except ModuleNotFoundError:
        log.info("with rich (pip install 'camtopod[terminal]') this fills the screen")
        return False
    console = Console()
    if console.is_dumb_terminal:
        return False

    logging.disable()  # messages would disturb the screen
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live, _keys():
            while not stop.is_set():
                texts = [Text(part, no_wrap=True, overflow="ellipsis") for part in view()]
                for text in texts:
                    text.highlight_regex("(?m)^!.*", "bold yellow")
                state, *tables = texts
                state.append("\nq ends it", style="dim")
                screen = Layout()
                state_part = Layout(state, size=len(state.plain.splitlines()) + 1)
                screen.split_column(state_part, *map(Layout, tables))
                live.update(screen, refresh=True)
                if _ended(stop):
                    break
    finally:
        logging.disable(logging.NOTSET)
    return True


@contextlib.contextmanager
def _keys() -> Iterator[None]:
    """Take keys from the terminal one by one, unseen, while the block runs."""
    if not sys.stdin.isatty():
        yield
        return
    before = termios.tcgetattr(0)
    tty.setcbreak(0)
    try:
        yield
    finally:
        termios.tcsetattr(0, termios.TCSADRAIN, before)


def _ended(stop: threading.Event) -> bool:
    """Wait for the next view; return True if q is pressed meanwhile, or the terminal is gone."""
    if not sys.stdin.isatty():
        return stop.wait(REFRESH_SECONDS)
    ready, _, _ = select.select([0], [], [], REFRESH_SECONDS)
    return bool(ready) and os.read(0, 1) in (b"q", b"Q", b"")


def parts(site: SiteState, topology: Topology | None, now: float) -> list[str]:
    """Return state and alarms, cameras, links, and predictions, each as lines of text.

    Control sequences in others' texts are made visible.

    now: Unix seconds.
    """
    state = [site.daemon_line(topology), *topology_lines(topology)]
    if alarms := alarm_lines(topology, now):
        state += ["", "ALARMS", *alarms]
    cameras = [
        f"  {site.beginning()}{'CAMERA':<20} {'STATE':<13} {'EVENTS':>8} {'LAST':>9}  REASON",
        *site.camera_lines(topology, now),
    ]
    links = [
        f"  {site.beginning()}{'FROM':<20} {'TO':<20} {'RELATION':<10} {'PROBABILITY':>11} "
        f"{'TRANSIT (q10 to q90)':>23}"
    ]
    if topology is not None:
        links += [
            f"  {site.beginning(camera_of(link.from_))}{link.from_:<20} {link.to:<20} "
            f"{link.relation:<10} {link.probability:>11.2f} {transit(link):>23}"
            for link in busiest_links(topology)[:LINKS_SHOWN]
        ]
    predictions = ["PREDICTIONS", *site.prediction_lines()]
    sections = (state, cameras, links, predictions)
    return ["\n".join(map(visible, lines)) for lines in sections]
