"""`camtopod watch`: live view of cameras, topology and predictions in the terminal."""

from __future__ import annotations

import argparse
import shutil
import sys
import threading
import time
from collections import deque
from typing import Any

import msgspec

from camtopod import codec
from camtopod.cli import exits
from camtopod.cli.common import configuration, start_logging, until_signal
from camtopod.cli.exits import CommandError
from camtopod.records import Prediction, Topology
from camtopod.serve import clock
from camtopod.serve.bus import BusError, dial
from camtopod.serve.subscriber import TopologyView

REFRESH_SECONDS = 0.5
ONCE_SECONDS = 3.0
"""How long --once waits for something to show."""
PREDICTIONS_SHOWN = 8
LINKS_SHOWN = 20
NEXT_SHOWN = 3
ALARMS_SHOWN = 5
_CLEAR = "\x1b[H\x1b[J"


def add_parser(subparsers: Any) -> None:
    """Add `watch`."""
    parser = subparsers.add_parser(
        "watch",
        help="live view in the terminal",
        description="Shows cameras, the learned topology and predictions as they come, until interrupted.",
    )
    parser.add_argument("--once", action="store_true", help="show the state once, without waiting for more, and end")


class Board:
    """What is known at the moment; filled by the bus's threads, drawn by `draw`."""

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._status: dict[str, dict[str, Any]] = {}
        self._predictions: deque[Prediction] = deque(maxlen=PREDICTIONS_SHOWN)

    def on_status(self, key: str, payload: bytes) -> None:
        """A publication on ``status/...``."""
        try:
            status = msgspec.msgpack.decode(payload, type=dict[str, Any])
        except (msgspec.MsgspecError, UnicodeDecodeError):
            return
        with self._mutex:
            self._status[key.removeprefix("status/")] = status

    def on_prediction(self, key: str, payload: bytes) -> None:
        """A publication on ``prediction/{camera}``."""
        try:
            prediction = codec.read(Prediction, payload, pack=True)
        except codec.Rejected:
            return
        with self._mutex:
            self._predictions.append(prediction)

    @property
    def empty(self) -> bool:
        """Whether no status has come yet."""
        with self._mutex:
            return not self._status

    def draw(self, topology: Topology | None, site: str, now: float) -> list[str]:
        """The view as lines; ``now`` in seconds since the epoch."""
        with self._mutex:
            status, predictions = dict(self._status), list(self._predictions)
        daemon = status.pop("daemon", None)
        return [
            *_head(topology, daemon, site),
            "",
            *_cameras(status, daemon or {}, now),
            "",
            *_links(topology),
            "",
            *_alarms(topology, now),
            *_predictions(predictions),
        ]


def run(args: argparse.Namespace) -> int:
    """Draw until SIGTERM or SIGINT."""
    start_logging(args)
    config = configuration(args)
    board = Board()
    try:
        bus = dial(config)
    except BusError as error:
        raise CommandError(str(error), exits.BUS) from None
    with bus, until_signal() as stop:
        bus.subscribe("status/*", board.on_status)
        bus.subscribe("prediction/*", board.on_prediction)
        view = TopologyView(bus)
        for key, payload in bus.ask("status/*"):
            board.on_status(key, payload)
        once_until = time.monotonic() + ONCE_SECONDS
        while not stop.is_set():
            view.update()
            ready = not board.empty or time.monotonic() >= once_until
            if not args.once or ready:
                _show(board.draw(view.topology, config.site.name, clock.wall()), args.once)
            if args.once and ready:
                break
            stop.wait(REFRESH_SECONDS)
    return exits.DONE


def _show(lines: list[str], once: bool) -> None:
    width, height = shutil.get_terminal_size()
    if sys.stdout.isatty() and not once:
        sys.stdout.write(_CLEAR + "\n".join(line[:width] for line in lines[: height - 1]) + "\n")
    else:
        sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()


def _head(topology: Topology | None, daemon: dict[str, Any] | None, site: str) -> list[str]:
    if daemon is None:
        first = f"site {site}: no daemon has said anything yet"
    else:
        events = daemon.get("events", {})
        first = (
            f"site {site}: daemon {daemon.get('state')}{_because(daemon)}, "
            f"{events.get('stored', 0)} events stored, {events.get('duplicate', 0)} duplicates, "
            f"{sum(daemon.get('rejects', {}).values())} rejected"
        )
    if topology is None:
        return [first, "topology: nothing learned yet"]
    return [
        first,
        f"topology: version {topology.version}, {topology.events} events, {len(topology.cameras)} cameras, "
        f"{len(topology.zones)} zones, {len(topology.links)} links, {topology.digest[:19]}",
        *_score(topology),
    ]


def _score(topology: Topology) -> list[str]:
    s = topology.score
    if s is None:
        return []
    return [
        f"predictions: next camera right {s.top1:.2f} (the usual one {s.baseline_top1:.2f}), among three {s.top3:.2f}, "
        f"log loss {s.log_loss:.2f} ({s.baseline_log_loss:.2f}); {s.exits} exits since version {s.since_version}"
    ]


def _alarms(topology: Topology | None, now: float) -> list[str]:
    alarms = (topology.alarms if topology is not None else None) or []
    if not alarms:
        return []
    rows = [
        f"{(now - alarm.t) / 60:.0f} min ago, version {alarm.version}: {alarm.kind} {alarm.subject}, {alarm.detail}"
        for alarm in reversed(alarms[-ALARMS_SHOWN:])
    ]
    return ["ALARMS", *rows, ""]


def _cameras(status: dict[str, dict[str, Any]], daemon: dict[str, Any], now: float) -> list[str]:
    known: dict[str, dict[str, Any]] = daemon.get("cameras", {})
    rows = [f"{'CAMERA':<20} {'STATE':<11} {'EVENTS':>8} {'LAST':>9}  REASON"]
    for camera in sorted({*status, *known}):
        said, counted = status.get(camera, {}), known.get(camera, {})
        state = said.get("state") or ("unknown" if counted.get("alive") else "no grabber")
        newest = counted.get("newest")
        last = "" if newest is None or not 0 <= now - newest < 1e6 else f"{now - newest:.0f} s"
        rows.append(f"{camera:<20} {state:<11} {counted.get('events', 0):>8} {last:>9}  {said.get('reason', '')}")
    return rows


def _links(topology: Topology | None) -> list[str]:
    rows = [f"{'FROM':<20} {'TO':<20} {'RELATION':<10} {'SHARE':>6} {'TRANSIT (q10 - q90)':>22}"]
    links = [link for link in topology.links if link.relation != "visible"] if topology is not None else []
    for link in sorted(links, key=lambda link: -link.transitions)[:LINKS_SHOWN]:
        transit = f"{link.transit.q50:.1f} ({link.transit.q10:.1f} - {link.transit.q90:.1f}) s"
        rows.append(f"{link.from_:<20} {link.to:<20} {link.relation:<10} {link.probability:>6.2f} {transit:>22}")
    if len(links) > LINKS_SHOWN:
        rows.append(f"... and {len(links) - LINKS_SHOWN} more")
    return rows


def _predictions(predictions: list[Prediction]) -> list[str]:
    rows = ["PREDICTIONS"]
    for prediction in reversed(predictions):
        following = ", ".join(
            f"{following.zone} {following.probability:.2f} in {following.q10:.0f}-{following.q90:.0f} s"
            for following in prediction.next_[:NEXT_SHOWN]
        )
        rows.append(f"{prediction.zone or prediction.camera} -> {following or 'nobody knows'}")
    return rows


def _because(status: dict[str, Any]) -> str:
    return f" ({status['reason']})" if status.get("reason") else ""
