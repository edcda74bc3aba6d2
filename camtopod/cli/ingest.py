"""`camtopod ingest`: other programs' events onto the bus."""

from __future__ import annotations

import argparse
import contextlib
import logging
import queue
import threading
from collections.abc import Iterator
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import configuration, start_logging, until_signal
from camtopod.cli.exits import CommandError
from camtopod.cli.lines import LineReader, open_input
from camtopod.records import Event
from camtopod.serve.bus import BusError, dial
from camtopod.serve.database import StateError
from camtopod.serve.publisher import Publisher
from camtopod.serve.spool import open_spool

log = logging.getLogger(__name__)

FORMATS = ("jsonl",)
UNACKNOWLEDGED_MAX = 50_000
"""Reading waits while this many events are not acknowledged."""
PATIENCE_SECONDS = 10.0
"""Without a daemon in sight nor a single acknowledgement for this long there is none. One in sight is waited for: it
may be fitting, or its disk be full, and says so in its status.
"""
_TICK_SECONDS = 0.2


def add_parser(subparsers: Any) -> None:
    """Add `ingest`."""
    parser = subparsers.add_parser(
        "ingest",
        help="other programs' events onto the bus",
        description="Publishes events on the bus, and ends when the daemon has stored them all. "
        "jsonl: event lines as `camtopod grab --out` writes them.",
    )
    parser.add_argument("format", choices=FORMATS, metavar="FORMAT", help=f"one of: {', '.join(FORMATS)}")
    parser.add_argument("file", nargs="?", default="-", metavar="FILE", help="default: standard input")
    parser.add_argument("--state", metavar="DIRECTORY", help="where the spool is kept (default: [state] directory)")


def run(args: argparse.Namespace) -> int:
    """Read, publish, wait for the acknowledgements."""
    start_logging(args)
    config = configuration(args)
    reader = LineReader()
    path = config.state_directory / "spool-ingest.db"
    with contextlib.ExitStack() as stack, until_signal() as stop:
        file = open_input(args.file)
        if args.file != "-":
            stack.callback(file.close)
        try:
            bus = dial(config)
        except BusError as error:
            raise CommandError(str(error), exits.BUS) from None
        stack.callback(bus.close)
        try:
            spool = open_spool(path, config.limits)
        except StateError as error:
            raise CommandError(str(error), exits.STATE) from None
        stack.callback(spool.close)
        publisher = Publisher(spool, config.limits.spool_batch_events)
        publisher.attach(bus)
        daemons: set[str] = set()
        bus.watch_alive("daemon", lambda name, alive: (daemons.add if alive else daemons.discard)(name))
        events = (line.event for line in reader.lines(args.file, file))
        for batch in batches(events, config.limits.spool_batch_events, stop):
            publisher.publish(*batch)
            _wait(publisher, UNACKNOWLEDGED_MAX, stop, config.site.name, daemons)
        _wait(publisher, 0, stop, config.site.name, daemons)
        log.info("%d events published, %d not acknowledged", publisher.published, publisher.unacknowledged)
    if (summary := reader.summary()) is not None:
        log.warning("%s", summary)
    return exits.DONE


def batches(events: Iterator[Event], most: int, stop: threading.Event) -> Iterator[list[Event]]:
    """What is there already, at most ``most``: lines that trickle in go out at once, a file in bulk."""
    waiting: queue.Queue[Event | None] = queue.Queue(2 * most)

    def read() -> None:
        try:
            for event in events:
                waiting.put(event)
        finally:
            waiting.put(None)

    threading.Thread(target=read, daemon=True).start()
    batch: list[Event] = []
    while not stop.is_set():
        try:
            event = waiting.get(block=not batch, timeout=_TICK_SECONDS)
        except queue.Empty:
            if batch:
                yield batch
                batch = []
            continue
        if event is None:
            break
        batch.append(event)
        if len(batch) >= most:
            yield batch
            batch = []
    if batch:
        yield batch


def _wait(publisher: Publisher, most: int, stop: threading.Event, site: str, daemons: set[str]) -> None:
    """Until at most ``most`` events are not acknowledged. Raises `CommandError` when there is nobody to do it."""
    patience, before = PATIENCE_SECONDS, publisher.unacknowledged
    while not stop.is_set() and not publisher.drained(_TICK_SECONDS, most):
        publisher.retry()
        now = publisher.unacknowledged
        patience = PATIENCE_SECONDS if now < before or daemons else patience - _TICK_SECONDS
        before = now
        if patience <= 0:
            raise CommandError(
                f"{now} events are not acknowledged: is `camtopod run` running for site {site}? "
                f"They wait in the spool and go out with the next ingest",
                exits.BUS,
            )
