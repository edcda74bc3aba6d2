"""`camtopod watch`: show cameras, topology and predictions live in the terminal."""

from __future__ import annotations

import argparse
import contextlib
import shutil
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import configuration, start_logging, until_signal
from camtopod.cli.exits import CommandError
from camtopod.cli.site_choice import dial_as_reader
from camtopod.cli.terminal import (
    SiteState,
    SiteView,
    alarm_line,
    busiest_links,
    daemon_line,
    newest_alarms,
    prediction_line,
    topology_lines,
    transit,
)
from camtopod.serve.bus import BusError, TopologySubscriber
from camtopod.serve.runtime import clock
from camtopod.visible import visible

REFRESH_SECONDS = 0.5
"""Interval between two drawings of the plain view."""
FOLLOW_SECONDS = 0.25
"""Interval at which new versions are fetched."""
ONCE_SECONDS = 3.0
"""Time that --once waits for a first status."""
PREDICTIONS_SHOWN = 8
"""Newest predictions in the plain view."""
LINKS_SHOWN = 20
"""Busiest links in the plain view."""
_CLEAR = "\x1b[H\x1b[J"
"""Control sequence that empties the terminal."""


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
    """Draw until SIGTERM or SIGINT."""
    start_logging(args)
    config = configuration(args)
    board = SiteState()
    try:
        bus, config = dial_as_reader(args, config)
    except BusError as error:
        raise CommandError(str(error), exits.BUS) from None
    with bus, until_signal() as stop:
        # Subscribe first, then ask for the newest statuses.
        bus.subscribe("status/*", board.on_status)
        bus.subscribe("prediction/*", board.on_prediction)
        topology = TopologySubscriber(bus)
        for key, payload in bus.query("status/*"):
            board.on_status(key, payload)

        def look() -> SiteView:
            return board.view(topology.topology, config.site.name, clock.wall())

        if args.once:
            _once(board, topology, look, stop)
            return exits.DONE
        with _following(topology, stop):
            if args.plain or not _on_screen(look, stop):
                while not stop.is_set():
                    _show(look())
                    stop.wait(REFRESH_SECONDS)
    return exits.DONE


def _once(
    board: SiteState,
    topology: TopologySubscriber,
    look: Callable[[], SiteView],
    stop: threading.Event,
) -> None:
    """Print the state once, as soon as a status has arrived."""
    until = time.monotonic() + ONCE_SECONDS
    topology.update()
    while board.empty and time.monotonic() < until and not stop.wait(FOLLOW_SECONDS):
        topology.update()
    print("\n".join(lines(look())), flush=True)


@contextlib.contextmanager
def _following(topology: TopologySubscriber, stop: threading.Event) -> Any:
    """Fetch new versions while the block runs, in a thread: an absent daemon takes time."""

    def follow() -> None:
        while not stop.wait(FOLLOW_SECONDS):
            topology.update()

    topology.update()
    thread = threading.Thread(target=follow, name="follow", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(REFRESH_SECONDS)


def _on_screen(look: Callable[[], SiteView], stop: threading.Event) -> bool:
    """Draw with rich until ``stop``; return False at once if rich or a terminal is missing."""
    if not sys.stdout.isatty():
        return False
    try:
        from camtopod.cli.terminal import show
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "rich":
            raise
        return False
    return show(look, stop)


def _show(view: SiteView) -> None:
    """Print the plain view, over the last one if this is a terminal."""
    width, height = shutil.get_terminal_size()
    text = lines(view)
    if sys.stdout.isatty():
        sys.stdout.write(_CLEAR + "\n".join(line[:width] for line in text[: height - 1]) + "\n")
    else:
        sys.stdout.write("\n".join(text) + "\n")
    sys.stdout.flush()


def lines(view: SiteView) -> list[str]:
    """Return the whole view as lines; control sequences in others' texts are made visible."""
    text = [
        daemon_line(view),
        *topology_lines(view.topology),
        "",
        *_cameras(view),
        "",
        *_links(view),
        "",
        *_alarms(view),
        "PREDICTIONS",
        *(prediction_line(prediction) for prediction in view.predictions[:PREDICTIONS_SHOWN]),
    ]
    return [visible(line) for line in text]


def _cameras(view: SiteView) -> list[str]:
    """Return the table of cameras."""
    rows = [f"{'CAMERA':<20} {'STATE':<11} {'EVENTS':>8} {'LAST':>9}  REASON"]
    for camera in view.cameras:
        last = "" if camera.last is None else f"{camera.last:.0f} s"
        rows.append(
            f"{camera.name:<20} {camera.state:<11} {camera.events:>8} {last:>9}  {camera.reason}"
        )
    return rows


def _links(view: SiteView) -> list[str]:
    """Return the table of links."""
    rows = [f"{'FROM':<20} {'TO':<20} {'RELATION':<10} {'SHARE':>6} {'TRANSIT (q10 to q90)':>23}"]
    links = busiest_links(view.topology)
    rows += [
        f"{link.from_:<20} {link.to:<20} {link.relation:<10} "
        f"{link.probability:>6.2f} {transit(link):>23}"
        for link in links[:LINKS_SHOWN]
    ]
    if len(links) > LINKS_SHOWN:
        rows.append(f"... and {len(links) - LINKS_SHOWN} more")
    return rows


def _alarms(view: SiteView) -> list[str]:
    """Return the newest alarms, with a heading."""
    alarms = newest_alarms(view.topology)
    return ["ALARMS", *(alarm_line(alarm, view.now) for alarm in alarms), ""] if alarms else []
