"""`camtopod predict`: for each exit of recorded events, predict where the object appears next.

With ``--walks``: for each entry, tell which earlier passages it may continue.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator
from typing import Any

from msgspec.structs import replace

from camtopod.cli.commands.export import load
from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.exits import InputError
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.predict import Predictor, Walks
from camtopod.records import Event, Match, Prediction, Topology


def add_parser(add: Any) -> None:
    """Add `predict`."""
    parser = add(
        description="Predicts for each exit of recorded events where the object appears next, and "
        "prints one prediction per line.",
        epilog="example: camtopod predict topology.json events.jsonl --top 3 > predictions.jsonl",
    )
    parser.add_argument(
        "--walks",
        action="store_true",
        help="print for each entry which earlier passages it may continue, and the walk that it "
        "belongs to, in place of predictions",
    )
    parser.add_argument(
        "topology", metavar="TOPOLOGY.json", help="topology as `camtopod learn` writes it"
    )
    parser.add_argument(
        "events", metavar="EVENTS", help="file of event lines ('-': standard input)"
    )
    parser.add_argument(
        "--top",
        metavar="N",
        type=_count,
        help="print only the N likeliest next appearances (or passages); the probabilities of the "
        "rest are summed in the field others (or new)",
    )


def _count(text: str) -> int:
    """Parse the value of --top."""
    if not text.isdecimal() or not text.isascii() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def run(args: argparse.Namespace) -> None:
    """Print a line for each exit (or entry) line, in input order; each uses only earlier events."""
    topology = load(args.topology)
    reader = LineReader()
    lines = list(reader.merged([args.events]))
    if reader.read and not lines:
        print(f"camtopod: {reader.summary()}", file=sys.stderr)
        raise InputError(f"no event lines in {args.events}: nothing to predict")

    # Answer in the order of time.
    by_time = sorted(range(len(lines)), key=lambda k: lines[k].event.t)
    events = [lines[k].event for k in by_time]
    answering = matches(topology, events) if args.walks else predictions(topology, events)
    done = "entries matched" if args.walks else "exits predicted"
    answers: dict[int, bytes] = {}
    with Progress() as progress:
        for k, answer in zip(by_time, answering, strict=True):
            if answer is not None:
                answers[k] = to_json(shortened(answer, args.top))
            progress.show(f"%d {done} of %d lines", len(answers), len(lines))

    # Print in the order of the input.
    for k in sorted(answers):
        sys.stdout.buffer.write(answers[k] + b"\n")
    sys.stdout.buffer.flush()
    if (summary := reader.summary()) is not None:
        print(f"camtopod: {summary}", file=sys.stderr)


def predictions(topology: Topology, events: list[Event]) -> Iterator[Prediction | None]:
    """Yield the prediction of each exit, None for each entry.

    events: in order of time. Those of one moment become known when time has moved on.
    """
    predictor = Predictor(topology)
    for _, moment in itertools.groupby(events, key=lambda event: event.t):
        simultaneous = list(moment)
        for event in simultaneous:
            yield predictor.predict(event) if event.kind == "exit" else None
        for event in simultaneous:
            predictor.observe(event)


def matches(topology: Topology, events: list[Event]) -> Iterator[Match | None]:
    """Yield the match of each entry, None for each exit.

    events: in order of time. Of one moment, exits that end earlier passages count before entries.
    """
    walks = Walks(topology)
    for _, moment in itertools.groupby(events, key=lambda event: event.t):
        simultaneous = list(moment)
        begun = {(one.camera, one.track) for one in simultaneous if one.kind == "entry"}
        ending = [
            one.kind == "exit" and (one.camera, one.track) not in begun for one in simultaneous
        ]
        for event, first in zip(simultaneous, ending, strict=True):
            if first:
                walks.observe(event)
        for event, first in zip(simultaneous, ending, strict=True):
            yield None if first else walks.observe(event)


def shortened(answer: Prediction | Match, most: int | None) -> Prediction | Match:
    """Return an answer with the ``most`` likeliest outcomes; ``others`` or ``new`` has the rest."""
    if most is None:
        return answer
    if isinstance(answer, Match):
        rest = sum(one.probability for one in answer.from_[most:])
        return replace(answer, from_=answer.from_[:most], new=answer.new + rest)
    others = [one.probability for one in answer.candidates[most:]]
    return replace(
        answer,
        candidates=answer.candidates[:most],
        others=sum(others) if others else None,
        look=answer.look and answer.look[:most],
        in_view=answer.in_view and answer.in_view[:most],
    )
