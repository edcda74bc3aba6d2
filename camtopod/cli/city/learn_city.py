"""`camtopod learn --districts`: learn a city, each of its districts in a process of its own.

The events are split by district into a folder beside the output, which goes when the output is
there. It is named by recording, districts and settings, so the same command goes on from it.
"""

from __future__ import annotations

import argparse
import hashlib
import ipaddress
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from camtopod import __version__
from camtopod.city import recordings
from camtopod.city.merge import EPOCH_DIGITS
from camtopod.cli import exits
from camtopod.cli.city.merge import write
from camtopod.cli.common import configuration, districts_of
from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.events.recording import Times, fault_of, once_by_number, recorded
from camtopod.cli.exits import CommandError, InputError
from camtopod.cli.terminal import ProgressLine, topology_lines
from camtopod.codec import read, to_json
from camtopod.config import owners_of
from camtopod.records import Event

CONNECT_SECONDS = 30.0
"""Longest time until a scheduler answers."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of cities to `learn`."""
    group = parser.add_argument_group("cities")
    group.add_argument(
        "--districts",
        metavar="FILE",
        type=Path,
        help="learn each of these districts in a process of its own, one a core at a time, and "
        "write one topology as `camtopod merge` does; if it is interrupted, the same command goes "
        "on",
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="learn them on the workers of this Dask scheduler (tls://HOST:PORT; certificates as "
        "in Dask's configuration), all of which see the folder of the output",
    )
    group.add_argument(
        "--insecure",
        action="store_true",
        help="take a scheduler on another machine without TLS",
    )


def run(args: argparse.Namespace) -> int:
    """Learn a city; write its topology. Raises `OSError`, `CommandError`."""
    for is_mistake, sentence in (
        (args.districts is None, "--scheduler and --insecure are for --districts"),
        (args.updates or args.table, "--districts goes without --updates and --table"),
        (args.topology in (None, "-"), "--districts needs --topology OUT.json"),
        ("-" in args.events, "--districts reads files, not standard input"),
        (
            args.scheduler and not args.insecure and not is_private(args.scheduler),
            f"on the way to {args.scheduler} others could take over its workers: use tls://, or "
            "--insecure in a network without others",
        ),
    ):
        if is_mistake:
            raise CommandError(sentence, exits.USAGE)
    districts = districts_of(args.districts)
    settings = configuration(args).learner
    reader, times = LineReader(), Times()
    out = Path(args.topology).resolve()
    stamps = [
        (os.path.realpath(path), os.stat(path).st_size, os.stat(path).st_mtime_ns)
        for path in args.events
    ]
    key = hashlib.sha256(to_json((__version__, stamps, districts, settings))).hexdigest()
    folder = out.with_name(f"{out.name}.{key[:EPOCH_DIGITS]}.parts")
    is_resumed = folder.exists()
    try:
        with _submitting(args.scheduler) as submit, ProgressLine(lines=True) as progress:
            city = recordings.learn_city(
                submit,
                _events(reader, args.events, times, owners_of(districts), progress),
                districts,
                folder,
                settings,
                args.site or "city",
                lambda count: progress.show(
                    "[%-20s] %d of %d districts",
                    "#" * (20 * count // len(districts)),
                    count,
                    len(districts),
                ),
                lambda: _note(reader, times),
            )
    except (recordings.CityError, ValueError) as error:
        if not (is_resumed or reader.events):
            shutil.rmtree(folder, ignore_errors=True)
            raise InputError(f"no event lines in {', '.join(args.events)}: {error}") from None
        hint = f"\nthe same command goes on from {folder}" if folder.exists() else ""
        raise CommandError(f"{error}{hint}") from None
    status, messages = read(tuple[int, list[str]], (folder / recordings.NOTE).read_bytes())
    write(city, out)
    shutil.rmtree(folder)
    for line in (*messages, *topology_lines(city.topology)):
        print(f"camtopod: {line}", file=sys.stderr)
    return status


def is_private(address: str) -> bool:
    """Return True if a scheduler is reached by TLS, or on this machine."""
    try:
        url = urlsplit(address if "://" in address else f"tcp://{address}")
        return (
            url.scheme == "tls"
            or url.hostname == "localhost"
            or ipaddress.ip_address(url.hostname or "").is_loopback
        )
    except ValueError:
        return False


@contextmanager
def _submitting(scheduler: str | None) -> Iterator[Callable[..., Future[None]]]:
    """Yield a function that submits a call: to a process a core, or to a scheduler's workers."""
    if scheduler is None:
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
            yield lambda *task: threads.submit(recordings.in_process, *task)
    else:
        from distributed import Client

        from camtopod.city.cluster import submitting

        with Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False) as client:
            yield submitting(client)


def _events(
    reader: LineReader,
    paths: list[str],
    times: Times,
    owners: dict[str, str],
    progress: ProgressLine,
) -> Iterator[Event]:
    """Yield the events of a recording in order of time; those without an owner are rejected."""
    for line in once_by_number(reader, recorded(reader, paths, times)):
        if line.event.camera in owners:
            yield line.event
        else:
            reader.reject_event(
                "no-district",
                f"{line.file}:{line.number}: no district owns {line.event.camera}",
            )
        if progress.due:
            progress.show("%d lines, %.0f %%", reader.lines_read, 100 * (reader.share() or 0.0))


def _note(reader: LineReader, times: Times) -> bytes:
    """Return exit status and messages about the lines of a recording, once they have been read."""
    fault = fault_of(times)
    messages = [message for message in (reader.summary(), fault) if message is not None]
    return to_json((exits.FAILED if fault else reader.status, messages))
