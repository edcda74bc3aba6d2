"""`camtopod learn`: the daemon's learner over recorded event lines.

With ``--updates`` every version that the daemon would have published is made, each with a fit of
its own. Without, the last one alone, in one fit of the last window. With ``--state`` a daemon can
go on from there.
"""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

from camtopod.cli.common import configuration
from camtopod.cli.events import LineReader
from camtopod.cli.exits import STATE, CommandError, InputError
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.config import Config
from camtopod.learn import STEPS, Learner
from camtopod.learn.window import EVENTS_PER_SECOND_MAX
from camtopod.records import Topology
from camtopod.serve import RecordedState
from camtopod.serve.runtime import wall
from camtopod.serve.storage import StateError

EPOCH = "recording"
"""Epoch of a topology learned from files: the same files give the same bytes."""


def add_parser(subparsers: Any) -> None:
    """Add `learn`."""
    summary = "the same learner over recorded event lines"
    about = (
        f"{summary.capitalize()}: in one fit of the last window or, with --updates, with every version that the daemon "
        "would have published on the way, which takes many times as long. The one fit has a version count and zone "
        "numbers of its own, and leaves out the score of its own predictions and clocks that changed, which only "
        "several versions tell."
    )
    parser = subparsers.add_parser("learn", help=summary, description=about)
    parser.add_argument(
        "events", nargs="+", metavar="EVENTS", help="files of event lines ('-': standard input)"
    )
    parser.add_argument(
        "--topology", metavar="OUT.json", help="the final topology goes here ('-': standard output)"
    )
    parser.add_argument(
        "--updates", metavar="OUT.jsonl", help="every version on the way, one a line"
    )
    state = "a new state directory, for a daemon that goes on from there (its [state] directory)"
    parser.add_argument("--state", metavar="DIR", type=Path, help=state)


def run(args: argparse.Namespace) -> int:
    """Learn; the topology goes to a file, or to standard output when no file is named."""
    config = configuration(args)
    reader = LineReader()
    if args.topology:
        check_output(args.topology)
    with ExitStack() as stack:
        state = stack.enter_context(_new_state(args.state, config)) if args.state else None
        epoch = EPOCH if state is None else state.epoch
        learner = Learner(
            config.learn, site=config.site.name, epoch=epoch, only_last=args.updates is None
        )
        updates = stack.enter_context(open_output(args.updates)) if args.updates else None
        try:
            _feed(learner, reader, args.events, updates, state)
        except StateError as error:
            raise CommandError(str(error), STATE) from None
    if (summary := reader.summary()) is not None:
        print(f"camtopod: {summary}", file=sys.stderr)
    if surplus := learner.statistics()["surplus"]:
        most = f"more than {EVENTS_PER_SECOND_MAX:.0f} events a second of one camera"
        print(
            f"camtopod: {surplus} events are not learned from: {most}, of which the newest count",
            file=sys.stderr,
        )
    topology = learner.topology
    if topology is None and args.state and learner.statistics()["accepted"]:
        print(
            "camtopod: nothing learned yet: all events are of the last moments, in which earlier ones may still come "
            f"(learn.lateness_seconds). The daemon that starts in {args.state} learns them with its next events",
            file=sys.stderr,
        )
        return 0
    if topology is None:
        raise InputError("no event lines in " + ", ".join(args.events) + ": nothing to learn from")
    if args.topology or not (args.updates or args.state):
        with open_output(args.topology or "-") as out:
            out.write(to_json(topology) + b"\n")
    print(f"camtopod: {describe(topology)}", file=sys.stderr)
    return 0


def _new_state(directory: Path, config: Config) -> RecordedState:
    """Raises `CommandError`."""
    try:
        return RecordedState(directory, config.keep, wall())
    except StateError as error:
        raise CommandError(str(error), STATE) from None


def _feed(
    learner: Learner,
    reader: LineReader,
    paths: list[str],
    updates: BinaryIO | None,
    state: RecordedState | None,
) -> None:
    """Pass every line to the learner, write each version and each event of the state, and report
    progress.
    """
    with Progress(piped=True) as progress:

        def say_step(step: str) -> None:
            number = 1 if learner.topology is None else learner.topology.version + 1
            progress.show(
                "version %d, step %d of %d: %s", number, STEPS.index(step) + 1, len(STEPS), step
            )

        learner.on_step = say_step
        for line in reader.merged(paths):
            verdict = learner.receive(line.event)
            if verdict != "accepted":
                reader.reject(verdict, f"{line.file}:{line.number}: {_WHY[verdict]}")
            elif state is not None:
                state.add(line.event)
            if progress.due:
                progress.show("%d lines%s", reader.read, _left(reader.share(), progress.seconds))
            _write(learner, updates)
        if state is None:
            learner.flush()
        else:  # what the lateness still holds back is learned by the daemon, with the events that come then
            learner.refresh()
            state.finish(learner)
        _write(learner, updates)


def _left(share: float | None, seconds: float) -> str:
    """The share of the input read in ``seconds``, and the time left, as text."""
    if not share:
        return ""
    return f", {100 * share:.0f} %, {seconds * (1 / share - 1):.0f} s until all are read"


_WHY = {
    "late": "later than the lateness allows (learn.lateness_seconds)",
    "duplicate": "the same boot and seq came before",
    "refused": "more cameras than learn.cameras_max",
}


def _write(learner: Learner, updates: BinaryIO | None) -> None:
    for topology in learner.updates():
        if updates is not None:
            updates.write(to_json(topology) + b"\n")


def describe(topology: Topology) -> str:
    """One line on a topology for people."""
    between = sum(link.relation != "visible" for link in topology.links)
    return (
        f"version {topology.version}: {topology.events} events, {len(topology.cameras)} cameras, "
        f"{len(topology.zones)} zones, {between} links between views, {len(topology.pairs)} related pairs of cameras"
    )


def check_output(path: str) -> None:
    """Say before long work, not after it, that its result cannot be written. Raises
    `CommandError`.
    """
    folder = Path(path).parent
    if path != "-" and not folder.is_dir():
        raise CommandError(f"cannot write {path}: {folder} is no directory")
    if path != "-" and not os.access(path if Path(path).exists() else folder, os.W_OK):
        raise CommandError(f"cannot write {path}: no permission")


def open_output(path: str) -> Any:
    """A file for writing bytes; ``-`` is standard output, which is left open. Raises
    `CommandError`.
    """
    if path == "-":
        return ExitStack().enter_context(_StandardOutput())
    try:
        return open(path, "wb")
    except OSError as error:
        raise CommandError(f"cannot write {path}: {error.strerror or error}") from None


class _StandardOutput:
    """Standard output as a context that does not close it."""

    def __enter__(self) -> _StandardOutput:
        return self

    def __exit__(self, *_: object) -> None:
        sys.stdout.buffer.flush()

    def write(self, data: bytes) -> None:
        sys.stdout.buffer.write(data)
