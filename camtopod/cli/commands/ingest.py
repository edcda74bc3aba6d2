"""`camtopod ingest`: publish events from other programs on the bus, or write them to a file."""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import logging
import queue
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from camtopod.adapt import FORMATS
from camtopod.cli import exits
from camtopod.cli.common import check_name, configuration, open_output, start_logging, until_signal
from camtopod.cli.events.event_lines import LineReader, open_input
from camtopod.cli.events.input_formats import add_options, events
from camtopod.cli.exits import CommandError, InputError
from camtopod.cli.site_choice import right_site
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.config import Config
from camtopod.records import Event
from camtopod.serve.bus import Bus, dial
from camtopod.serve.outbox import TRANSACTION_EVENTS_MAX, UNANSWERED, Publisher, open_ingest_spool

log = logging.getLogger(__name__)

WAITING_EVENTS_MAX = 100_000
"""Reading pauses while this many events are not stored, or a half of what the spool may hold.

The more of them are in the spool, the better the daemon knows for which cameras it has to wait.
"""
PATIENCE_SECONDS = 10.0
"""Time without a stored event after which a daemon that is not visible counts as absent.

A visible daemon is waited for: it may be busy with a refit, or its disk may be full, as its status
says.
"""
_TICK_SECONDS = 0.2
"""Interval at which input, stored events and progress are checked."""


def add_parser(subparsers: Any) -> None:
    """Add `ingest`."""
    parser = subparsers.add_parser(
        "ingest",
        help="publish events from other programs",
        description="Publishes events on the bus, and ends when the daemon has stored them all. "
        f"Formats: {'; '.join(f'{name}, {one.lines}' for name, one in FORMATS.items())}.",
        epilog="example: camtopod ingest jsonl events.jsonl --site hq",
    )
    parser.add_argument(
        "format", choices=tuple(FORMATS), metavar="FORMAT", help=f"one of: {', '.join(FORMATS)}"
    )
    parser.add_argument(
        "file", nargs="?", default="-", metavar="FILE", help="input (default: standard input)"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        help="write event lines to FILE ('-': standard output) instead of the bus",
    )
    parser.add_argument(
        "--state", metavar="DIRECTORY", help="directory of the spool (default: [state] directory)"
    )
    parser.add_argument(
        "--boot",
        metavar="NAME",
        help="number the events under this name, so that they count once however often they are "
        "ingested (default: digest of a regular file)",
    )
    parser.add_argument(
        "--anew",
        action="store_true",
        help="count the events of a regular file again, as if they were new",
    )
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read events and publish them until all are stored, or write them to a file."""
    start_logging(args)
    config = configuration(args)
    if args.boot is not None and args.anew:
        raise CommandError("--anew and --boot contradict each other", exits.USAGE)
    if args.boot is not None:
        check_name("--boot", args.boot)

    # Read and publish, or write.
    reader = LineReader()
    with contextlib.ExitStack() as stack, until_signal() as stop, Progress() as progress:

        def tell() -> None:
            if args.out != "-":
                progress.show("%d lines read, %d events", reader.read, reader.events)

        source = events(args, reader, stack, stop)
        if (boot := args.boot or _digest(args)) is not None:
            source = numbered_by(boot, source)
        read = batches(source, TRANSACTION_EVENTS_MAX, stop, tell)
        status = exits.DONE
        if args.out is not None:
            out = stack.enter_context(open_output(args.out))
            for batch in read:
                out.writelines(to_json(event) + b"\n" for event in batch)
                out.flush()
        else:
            status = _publish(config, read, stack, stop, progress)

    # Report what was not used.
    if (summary := reader.summary()) is not None:
        log.warning("%s", summary)
    if reader.read and sum(reader.rejected.values()) == reader.read:
        raise InputError(
            f"no line of {args.file} is valid {args.format}: nothing to ingest, see above"
        )
    if reader.read and not reader.events:
        log.warning("%d lines gave no event: %s", reader.read, FORMATS[args.format].no_events)
    return status


def _digest(args: argparse.Namespace) -> str | None:
    """Return the boot of a regular file's events, so that they count once however often it is
    ingested.

    None for a pipe, which can be read only once, and with --anew or --out.
    """
    if args.anew or args.out is not None or not Path(args.file).is_file():
        return None
    digest = hashlib.sha256()
    with open_input(args.file) as file:
        while piece := file.read(1 << 20):
            digest.update(piece)
    return f"file-{digest.hexdigest()[:32]}"


def numbered_by(boot: str, source: Iterator[Event]) -> Iterator[Event]:
    """Number each camera's events from 1 under ``boot``, except those that have a boot already."""
    counts: Counter[str] = Counter()
    for event in source:
        if event.boot is None:
            counts[event.camera] += 1
            yield msgspec.structs.replace(event, boot=boot, seq=counts[event.camera])
        else:
            yield event


def _publish(
    config: Config,
    source: Iterator[list[Event]],
    stack: contextlib.ExitStack,
    stop: threading.Event,
    progress: Progress,
) -> int:
    """Publish events, wait until all are stored and log the outcome; return the exit status."""
    # Open the spool and connect to the bus.
    spool = open_ingest_spool(config.state_directory, config.site.name, config.limits)
    stack.callback(spool.close)
    bus = dial(config)
    stack.callback(bus.close)
    publisher = Publisher(spool)
    stack.callback(publisher.close)
    publisher.attach(bus)
    daemons: set[str] = set()
    bus.watch_alive("daemon", lambda name, alive: (daemons.add if alive else daemons.discard)(name))

    # Publish batch by batch. Events that earlier runs have left are sent, too, but not waited for.
    limits = config.limits
    most = min(
        WAITING_EVENTS_MAX,
        limits.spool_events_max // 2,
        limits.spool_bytes_max // 2 // 1_000,
    )
    for batch in source:
        publisher.publish(*batch)
        _wait(publisher, most, stop, bus, config, daemons, progress)
    _wait(publisher, 0, stop, bus, config, daemons, progress)

    # Report the outcome.
    late, refused = publisher.outcome()
    waiting = publisher.count_waiting(own=True)
    stored = max(0, publisher.published - waiting - publisher.dropped)
    log.info("%s", _outcome(stored, waiting, late, refused))
    if late + refused and late + refused >= stored:
        return exits.FAILED
    return exits.DONE


def _outcome(stored: int, waiting: int, late: int, refused: int) -> str:
    """Return in words what became of the events."""
    parts = [f"{stored} events stored"]
    if late:
        parts.append(f"{late} of them late (older than the events learned last: not learned)")
    if refused:
        parts.append(f"{refused} refused (malformed, too many of one camera, or in the future)")
    if waiting:
        parts.append(f"{waiting} wait in the spool and are published with the next ingest")
    return ", ".join(parts)


def batches(
    events: Iterator[Event], most: int, stop: threading.Event, tell: Callable[[], None]
) -> Iterator[list[Event]]:
    """Yield batches of at most ``most`` events: those available now, so that slow input is not
    delayed.

    ``tell`` is called while no events come: some files give all their events at the end. Raises
    `CommandError` if reading fails; the reading thread prints why.
    """
    waiting: queue.Queue[Event | None] = queue.Queue(2 * most)
    whole = threading.Event()

    def read() -> None:
        try:
            for event in events:
                waiting.put(event)
            whole.set()
        finally:
            waiting.put(None)

    threading.Thread(target=read, daemon=True).start()

    # A batch ends when it is full or no event is waiting.
    batch: list[Event] = []
    while not stop.is_set():
        try:
            event = waiting.get(block=not batch, timeout=_TICK_SECONDS)
        except queue.Empty:
            tell()
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
    if not whole.is_set() and not stop.is_set():
        raise CommandError("reading failed before the end of the input, see above")


def _wait(
    publisher: Publisher,
    most: int,
    stop: threading.Event,
    bus: Bus,
    config: Config,
    daemons: set[str],
    progress: Progress,
) -> None:
    """Wait until at most ``most`` of the events of this run are not stored.

    Raises `CommandError` if no daemon stores any, or if it does not take one of the cameras.
    """
    patience = PATIENCE_SECONDS
    before = publisher.count_waiting(own=True)
    while not stop.is_set():
        progress.show("%d events published, %d not yet stored", publisher.published, before)
        if publisher.wait_stored(_TICK_SECONDS, most, own=True):
            return
        if refused := publisher.own_cameras_without_room():
            for camera in refused:
                publisher.drop(camera)
            raise CommandError(
                f"camera {', '.join(refused)}: {next(iter(refused.values()))}; "
                f"{publisher.dropped} events are dropped"
            )
        if unanswered := publisher.own_cameras_unanswered():
            raise CommandError(f"camera {', '.join(unanswered)}: {UNANSWERED}", exits.BUS)
        publisher.retry()
        now = publisher.count_waiting(own=True)
        patience = PATIENCE_SECONDS if now < before or daemons else patience - _TICK_SECONDS
        before = now
        if patience <= 0:
            raise CommandError(
                f"{now} events are not stored: is `camtopod run` running for site "
                f"{bus.site}? They are kept in the spool and published with the next ingest of "
                f"this site{right_site(bus, config)}",
                exits.BUS,
            )
