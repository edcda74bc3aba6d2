"""`camtopod ingest`: other programs' events onto the bus, or into a file."""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import logging
import queue
import re
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

from camtopod.cli import exits
from camtopod.cli.common import configuration, start_logging, until_signal
from camtopod.cli.events import (
    FORMATS,
    KNOWN_SECONDS,
    LineReader,
    Outcome,
    add_options,
    events,
    open_input,
)
from camtopod.cli.exits import CommandError, InputError
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.config import Config
from camtopod.records import CAMERA_PATTERN, Event
from camtopod.serve.bus import BusError, dial
from camtopod.serve.outbox import Publisher, open_spool
from camtopod.serve.storage import StateError

log = logging.getLogger(__name__)

UNACKNOWLEDGED_MAX = 50_000
"""Reading waits while this many events are not acknowledged."""
PATIENCE_SECONDS = 10.0
"""Without a daemon in sight nor a single acknowledgement for this long there is none. One in sight
is waited for: it may be fitting, or its disk be full, and says so in its status.
"""
_TICK_SECONDS = 0.2
_NO_EVENTS = {
    "frigate": "nobody has come in or left, or only objects that stand or are not among --label",
    "mot": "boxes with an id below 0 (detections, which no tracker has seen) or a confidence of 0 are of no track",
    "scenescape": "nobody has come in or left, or only objects that are not among --label",
}
"""Why lines that fit may come to nothing, by format."""


def add_parser(subparsers: Any) -> None:
    """Add `ingest`."""
    parser = subparsers.add_parser(
        "ingest",
        help="other programs' events onto the bus",
        description="Publishes events on the bus, and ends when the daemon has stored them all. "
        "jsonl: event lines as `camtopod grab --out` writes them. frigate: messages of frigate/events, a line each "
        "(mosquitto_sub -t frigate/events). mot: a MOTChallenge text file. scenescape: messages of "
        "scenescape/data/camera/ID, a line each.",
    )
    parser.add_argument(
        "format", choices=FORMATS, metavar="FORMAT", help=f"one of: {', '.join(FORMATS)}"
    )
    parser.add_argument(
        "file", nargs="?", default="-", metavar="FILE", help="default: standard input"
    )
    parser.add_argument(
        "--out", metavar="FILE", help="write event lines here ('-': standard output), use no bus"
    )
    parser.add_argument(
        "--state", metavar="DIRECTORY", help="where the spool is kept (default: [state] directory)"
    )
    parser.add_argument(
        "--boot",
        metavar="NAME",
        help="number the events under this name, so that they count once however often they are ingested (default: a "
        "regular file's digest)",
    )
    parser.add_argument(
        "--anew",
        action="store_true",
        help="count a regular file's events again, as if they were new",
    )
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, publish, wait for the acknowledgements; or write."""
    start_logging(args)
    config = configuration(args)
    if args.boot is not None and args.anew:
        raise CommandError("--anew and --boot contradict each other", exits.USAGE)
    if args.boot is not None and not re.match(CAMERA_PATTERN, args.boot):
        raise CommandError(
            f"--boot {args.boot!r}: 1 to 64 of the characters A-Z a-z 0-9 _ . -", exits.USAGE
        )
    reader = LineReader()
    with contextlib.ExitStack() as stack, until_signal() as stop, Progress() as progress:

        def tell() -> None:
            if args.out != "-":
                progress.show("%d lines read, %d events", reader.read, reader.events)

        source = events(args, reader, stack, stop)
        if (boot := args.boot or _digest(args)) is not None:
            source = numbered_by(boot, source)
        read = batches(source, config.limits.spool_batch_events, stop, tell)
        status = exits.DONE
        if args.out is not None:
            _write(args.out, read)
        else:
            status = _publish(config, read, stack, stop, progress)
    if (summary := reader.summary()) is not None:
        log.warning("%s", summary)
    if reader.read and sum(reader.rejected.values()) == reader.read:
        raise InputError(f"no line of {args.file} fits: nothing to ingest")
    if reader.read and not reader.events:
        log.warning("no event came of %d lines: %s", reader.read, _NO_EVENTS[args.format])
    return status


def _digest(args: argparse.Namespace) -> str | None:
    """The boot of a regular file's events: they count once, however often it is ingested. None for
    a pipe, which can be read once only, and if that is not wanted.
    """
    if args.anew or args.out is not None or not Path(args.file).is_file():
        return None
    digest = hashlib.sha256()
    with open_input(args.file) as file:
        while piece := file.read(1 << 20):
            digest.update(piece)
    return f"file-{digest.hexdigest()[:32]}"


def numbered_by(boot: str, source: Iterator[Event]) -> Iterator[Event]:
    """Each camera's events counted from 0, but for those that have numbers."""
    counts: Counter[str] = Counter()
    for event in source:
        if event.boot is None:
            yield msgspec.structs.replace(event, boot=boot, seq=counts[event.camera])
            counts[event.camera] += 1
        else:
            yield event


def _write(path: str, source: Iterator[list[Event]]) -> None:
    """Event lines, out as soon as they are there."""
    with contextlib.ExitStack() as stack:
        out: BinaryIO = sys.stdout.buffer
        if path != "-":
            try:
                out = stack.enter_context(open(path, "wb"))
            except OSError as error:
                raise CommandError(f"cannot write {path}: {error.strerror}") from None
        for batch in source:
            out.writelines(to_json(event) + b"\n" for event in batch)
            out.flush()


def _publish(
    config: Config,
    source: Iterator[list[Event]],
    stack: contextlib.ExitStack,
    stop: threading.Event,
    progress: Progress,
) -> int:
    """Publish, wait until everything is stored, and say what became of it; returns the exit
    status.
    """
    try:
        spool = open_spool(config.state_directory, config.site.name, "ingest", config.limits)
    except StateError as error:
        raise CommandError(str(error), exits.STATE) from None
    stack.callback(spool.close)
    try:
        bus = dial(config)
    except BusError as error:
        raise CommandError(str(error), exits.BUS) from None
    stack.callback(bus.close)  # before the spool, which may be asked until then
    outcome = Outcome()
    publisher = Publisher(spool, config.limits.spool_batch_events, outcome.on_ack)
    publisher.attach(bus)
    daemons: set[str] = set()
    bus.watch_alive("daemon", lambda name, alive: (daemons.add if alive else daemons.discard)(name))

    for batch in source:
        if new := outcome.new_cameras(batch):
            publisher.attach(bus, sorted(new))
            if any(event.boot is not None for event in batch):
                stop.wait(KNOWN_SECONDS)
        outcome.publishing(batch, spool.boot)
        publisher.publish(*batch)
        _wait(publisher, UNACKNOWLEDGED_MAX, stop, config.site.name, daemons, progress)
    _wait(publisher, 0, stop, config.site.name, daemons, progress)

    log.info(
        "%d events published, %d not acknowledged", publisher.published, publisher.unacknowledged
    )
    if not outcome.told:
        return exits.DONE
    accepted, late, refused, _ = outcome.counted()
    log.info("of these %s", outcome.in_words())
    return exits.FAILED if late + refused and not accepted else exits.DONE


def batches(
    events: Iterator[Event], most: int, stop: threading.Event, tell: Callable[[], None]
) -> Iterator[list[Event]]:
    """What is there already, at most ``most``: lines that trickle in go out at once, a file in
    bulk. ``tell`` is called while nothing comes: of some files all events come at the end.

    Raises `CommandError` when what it is read from fails; the thread that reads says why.
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
        raise CommandError("reading ended in the middle, see above")


def _wait(
    publisher: Publisher,
    most: int,
    stop: threading.Event,
    site: str,
    daemons: set[str],
    progress: Progress,
) -> None:
    """Until at most ``most`` events are not acknowledged. Raises `CommandError` when there is
    nobody to do it.
    """
    patience, before = PATIENCE_SECONDS, publisher.unacknowledged
    while not stop.is_set():
        progress.show(
            "%d events published, %d not yet stored", publisher.published, publisher.unacknowledged
        )
        if publisher.drained(_TICK_SECONDS, most):
            return
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
