"""`camtopod predict`: for each exit of recorded events, predict where the object appears next."""

from __future__ import annotations

import argparse
import itertools
import sys
from typing import Any

from msgspec.structs import replace

from camtopod.cli.commands.export import load
from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.exits import InputError
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.predict import Predictor
from camtopod.records import Prediction


def add_parser(add: Any) -> None:
    """Add `predict`."""
    parser = add(
        description="Predicts for each exit of recorded events where the object appears next, and "
        "prints one prediction per line.",
        epilog="example: camtopod predict topology.json events.jsonl --top 3 > predictions.jsonl",
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
        help="print only the N likeliest next appearances; the probabilities of the rest are "
        "summed in the field others",
    )


def _count(text: str) -> int:
    """Parse the value of --top."""
    if not text.isdecimal() or not text.isascii() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def run(args: argparse.Namespace) -> None:
    """Print a prediction line for each exit line, in input order; each uses only earlier events."""
    predictor = Predictor(load(args.topology))
    reader = LineReader()
    lines = list(reader.merged([args.events]))
    if reader.read and not lines:
        print(f"camtopod: {reader.summary()}", file=sys.stderr)
        raise InputError(f"no event lines in {args.events}: nothing to predict")

    # Predict in the order of time; events of one moment become known when time has moved on.
    by_time = sorted(range(len(lines)), key=lambda k: lines[k].event.t)
    answers: dict[int, bytes] = {}
    with Progress() as progress:
        for _, moment in itertools.groupby(by_time, key=lambda k: lines[k].event.t):
            numbers = list(moment)
            for k in numbers:
                if lines[k].event.kind == "exit":
                    answer = predictor.predict(lines[k].event)
                    if args.top is not None:
                        answer = shortened(answer, args.top)
                    answers[k] = to_json(answer)
            for k in numbers:
                predictor.observe(lines[k].event)
            progress.show("%d exits predicted of %d lines", len(answers), len(lines))

    # Print in the order of the input.
    for k in sorted(answers):
        sys.stdout.buffer.write(answers[k] + b"\n")
    sys.stdout.buffer.flush()
    if (summary := reader.summary()) is not None:
        print(f"camtopod: {summary}", file=sys.stderr)


def shortened(prediction: Prediction, most: int) -> Prediction:
    """Return the ``most`` likeliest next appearances; the sum of the others is in ``others``."""
    others = [one.probability for one in prediction.next_[most:]]
    return replace(
        prediction,
        next_=prediction.next_[:most],
        others=sum(others) if others else None,
        look=prediction.look and prediction.look[:most],
        in_view=prediction.in_view and prediction.in_view[:most],
    )
