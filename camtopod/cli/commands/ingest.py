"""`camtopod ingest`: publish events from other programs on the bus, or write them to a file."""

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
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec

from camtopod.adapt import FORMATS
from camtopod.cli import exits
from camtopod.cli.common import configuration, counted, open_output, start_logging, until_signal
from camtopod.cli.events.event_lines import ACCEPTED_MIN, LineReader
from camtopod.cli.events.input_formats import add_options, events
from camtopod.cli.events.recording import Times, fault_of
from camtopod.cli.exits import CommandError, InputError
from camtopod.cli.site_choice import right_site
from camtopod.cli.terminal import ProgressLine
from camtopod.codec import to_json
from camtopod.config import Config
from camtopod.records import Event
from camtopod.serve.bus import dial
from camtopod.serve.outbox import (
    OWNER,
    TRANSACTION_EVENTS_MAX,
    SiteDelivery,
    SiteLink,
    Spool,
    SpoolPublisher,
    open_ingest_spool,
)

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
_FILE_BOOT = re.compile(r"file-([0-9]{1,15})-[0-9a-f]{32}")
"""Boot of a file's events: its length when it was ingested first, in bytes, and its digest."""
_TICK_SECONDS = 0.2
"""Interval at which input, stored events and progress are checked."""


def add_parser(add: Any) -> None:
    """Add `ingest`."""
    parser = add(
        description="Publishes events on the bus, and ends when the daemon has stored them all. "
        f"Formats: {'; '.join(f'{name}, {form.lines}' for name, form in FORMATS.items())}.",
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
        "--anew",
        action="store_true",
        help="count the events of a regular file again, as if they were new",
    )
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read events and publish them until all are stored, or write them to a file."""
    start_logging(args)
    config = configuration(args)
    reader = LineReader()
    with contextlib.ExitStack() as stack, until_signal() as stop, ProgressLine() as progress:

        def tell() -> None:
            if args.out != "-":
                progress.show("%d lines read, %d events", reader.lines_read, reader.events)

        # Read and publish, or write.
        times = Times()
        set_aside = Counter[str]()
        source = events(args, reader, times, set_aside, stack, stop)
        is_file = Path(args.file).is_file()
        is_recording = is_file or (args.file == "-" and Path("/dev/stdin").is_file())
        status = exits.DONE
        if args.out is None:
            spool = open_ingest_spool(
                config.state_directory, config.site.name, config.limits, config.sites_of
            )
            stack.callback(spool.close)
            if is_file and not args.anew:
                owner_queue = spool.queue()
                boots = {
                    boot for camera in owner_queue.cameras() for boot in owner_queue.boots(camera)
                }
                source = numbered_by(boot_of(Path(args.file), boots), source, set_aside)
            event_batches = batches(source, TRANSACTION_EVENTS_MAX, stop, tell)
            status = _publish(config, spool, event_batches, not is_recording, stack, stop, progress)
        else:
            event_batches = batches(source, TRANSACTION_EVENTS_MAX, stop, tell)
            out = stack.enter_context(open_output(args.out, live=not is_file))
            for batch in event_batches:
                out.writelines(to_json(event) + b"\n" for event in batch)
                out.flush()

        # Report the unused part.
        if (summary := reader.summary()) is not None:
            log.warning("%s", summary)
        if (fault := fault_of(times)) is not None:
            log.warning("%s", fault)
            status = exits.FAILED
        if is_recording and not reader.lines_read and not stop.is_set():
            raise InputError(f"no event lines in {args.file}: nothing to ingest")
        if reader.lines_read and sum(reader.rejections.values()) == reader.lines_read:
            raise InputError(
                f"no line of {args.file} is valid {args.format}: nothing to ingest, see above"
            )
    if reader.lines_read and not reader.events:
        log.warning(
            "%d lines gave no event: no object entered or left, or only such as do not count "
            "(untracked, stationary, outside the picture, a face or plate, not among --label)",
            reader.lines_read,
        )
    return status or reader.status


def boot_of(path: Path, boots: Collection[str]) -> str:
    """Return the boot of a file's events: they count once however often it is ingested.

    It is named after the file's length and content. A file that has grown since goes on with the
    boot of its beginning.

    boots: boots of earlier events.
    """
    lengths = sorted({int(match[1]) for boot in boots if (match := _FILE_BOOT.fullmatch(boot))})
    digest = hashlib.sha256()
    position = 0
    with path.open("rb") as file:
        for length in [*lengths, sys.maxsize]:
            while piece := file.read(min(length - position, 1 << 20)):
                digest.update(piece)
                position += len(piece)
            boot = f"file-{position}-{digest.hexdigest()[:32]}"
            if boot in boots:
                break
    return boot


def numbered_by(boot: str, source: Iterator[Event], set_aside: Counter[str]) -> Iterator[Event]:
    """Number each camera's events from 1 under ``boot``, except those that have a boot already.

    set_aside: how many numbers of each camera are for lines that were set aside.
    """
    counts: Counter[str] = Counter()
    for event in source:
        if event.boot is None:
            counts[event.camera] += 1
            seq = counts[event.camera] + set_aside[event.camera]
            event = msgspec.structs.replace(event, boot=boot, seq=seq)
        yield event


def _publish(
    config: Config,
    spool: Spool,
    source: Iterator[list[Event]],
    live: bool,
    stack: contextlib.ExitStack,
    stop: threading.Event,
    progress: ProgressLine,
) -> int:
    """Publish events, wait until all are stored and log the outcome; return the exit status.

    live: deliver events as they come. A recording is delivered when all of it, or as much as may
        wait, is in the spool: a camera whose spool is empty has told the daemon all that it has.
    """
    bus = dial(config)
    stack.callback(bus.close)
    publisher = SpoolPublisher(spool, live)
    stack.callback(publisher.close)

    # Publish batch by batch. Events that earlier runs have left are sent, too, but not waited for.
    limits = config.limits
    waiting_max = min(
        WAITING_EVENTS_MAX, limits.spool_events_max // 2, limits.spool_bytes_max // 2 // 1_000
    )
    while not live and publisher.count_waiting(own=True) < waiting_max:
        if (batch := next(source, None)) is None:
            break
        publisher.publish(*batch)
        progress.show("%d events read", publisher.published)
    publisher.attach(bus)
    all_sites = dict.fromkeys([OWNER])
    for camera in config.cameras:
        all_sites |= dict.fromkeys(config.sites_of(camera)[1:])
    for site in [*all_sites][1:]:
        stack.callback(SiteLink(config, publisher, (), site).close)
    sites = [*all_sites]
    for batch in source:
        publisher.publish(*batch)
        for site, error in _wait(publisher, waiting_max, stop, config, progress, sites).items():
            if site == OWNER:
                raise error
            sites.remove(site)
            log.warning("the input does not wait for site %s: %s", site, error)
    if errors := _wait(publisher, 0, stop, config, progress, all_sites):
        raise next(iter(errors.values()))

    # Report the outcome.
    late, refusals = publisher.outcome()
    backlog = publisher.count_waiting(own=True)
    lost_count = publisher.statistics()["dropped"]
    stored_count = max(0, publisher.published - backlog - lost_count)
    log.info("%s", _outcome(stored_count, publisher.repeats, backlog, late, refusals))
    is_enough = stored_count - refusals >= ACCEPTED_MIN * stored_count
    return exits.DONE if is_enough else exits.FAILED


def _outcome(stored_count: int, repeats: int, backlog: int, late: int, refusals: int) -> str:
    """Return in words what became of the events."""
    parts = [f"{stored_count} events stored"]
    if repeats:
        parts.append(f"{repeats} had been ingested before")
    if late:
        parts.append(f"{late} of them late (older than the events learned last)")
    if refusals:
        parts.append(
            f"{refusals} of them refused (malformed, too many of one camera, or in the future)"
        )
    if backlog:
        parts.append(f"{backlog} wait in the spool and are published with the next ingest")
    return ", ".join(parts)


def batches(
    events: Iterator[Event], batch_max: int, stop: threading.Event, tell: Callable[[], None]
) -> Iterator[list[Event]]:
    """Yield batches of at most ``batch_max`` events: those available now, so that slow input is not
    delayed.

    ``tell`` is called while no events come: some files give all their events at the end. Raises
    what reading them raises.
    """
    event_queue: queue.SimpleQueue[Event | None] = queue.SimpleQueue()

    def read() -> None:
        try:
            for event in events:
                while event_queue.qsize() >= batch_max and not stop.wait(_TICK_SECONDS / 10):
                    pass
                event_queue.put(event)
        finally:
            event_queue.put(None)

    reading = ThreadPoolExecutor(1).submit(read)
    event: Event | None
    while not stop.is_set():
        try:
            event = event_queue.get(timeout=_TICK_SECONDS)
        except queue.Empty:
            tell()
            continue
        batch = []
        while event is not None:
            batch.append(event)
            if len(batch) == batch_max or event_queue.empty():
                break
            event = event_queue.get()
        if batch:
            yield batch
        if event is None:
            reading.result()
            return


def _wait(
    publisher: SpoolPublisher,
    waiting_max: int,
    stop: threading.Event,
    config: Config,
    progress: ProgressLine,
    sites: Collection[str],
) -> dict[str, CommandError]:
    """Wait until at most ``waiting_max`` of the events of this run wait for each site.

    Returns why one is not waited for: no daemon of it stores any, or it does not take a camera.
    """
    errors = {}
    for site in sites:
        try:
            _wait_for_site(publisher, waiting_max, stop, config, progress, site)
        except CommandError as error:
            errors[site] = error
    return errors


def _wait_for_site(
    publisher: SpoolPublisher,
    waiting_max: int,
    stop: threading.Event,
    config: Config,
    progress: ProgressLine,
    site: str,
) -> None:
    """Wait as `_wait` does, for one site. Raises `CommandError`."""
    patience = PATIENCE_SECONDS
    has_told = False
    before = publisher.count_waiting(own=True, site=site)
    while not stop.is_set():
        progress.show("%d events published, %d not yet stored", publisher.published, before)
        if publisher.wait_stored(_TICK_SECONDS, waiting_max, own=True, site=site):
            return
        delivery = publisher.at(site)
        if delivery is not None:
            _require_taken(publisher, delivery)
        publisher.retry()
        now = publisher.count_waiting(own=True, site=site)
        patience -= _TICK_SECONDS
        if now < before:
            patience = PATIENCE_SECONDS
        elif patience <= 0 and delivery is not None and delivery.sees_daemon:
            patience = PATIENCE_SECONDS
            if not has_told:
                has_told = True
                reason = delivery.own_reason() or "the daemon is busy: `camtopod doctor` tells more"
                log.warning("still waiting, %d events are not stored: %s", now, reason)
        before = now
        if patience <= 0:
            hint = ""
            if delivery is not None:
                hint = right_site(delivery.bus, config.at(delivery.bus.site))
            raise CommandError(
                f"{now} events are not stored: is `camtopod run` running for site "
                f"{site or config.site.name}? They are kept in the spool and published with the "
                f"next ingest of this site{hint}",
                exits.BUS,
            )


def _require_taken(publisher: SpoolPublisher, delivery: SiteDelivery) -> None:
    """Raise `CommandError` if a site does not take one of this run's cameras."""
    if reasons := delivery.own_cameras_without_room():
        for camera in reasons:
            publisher.drop(camera)
        raise CommandError(
            f"{next(iter(reasons.values()))}; {publisher.dropped} events of "
            f"{counted(len(reasons), 'camera')} are dropped"
        )
    if silent_cameras := delivery.own_cameras_unanswered():
        reason = f"camera {', '.join(silent_cameras)}: {delivery.unanswered_reason}"
        raise CommandError(reason, exits.BUS)
