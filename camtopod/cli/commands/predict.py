"""`camtopod predict`: for each exit of recorded events, where the object will appear next."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from camtopod.cli.commands.export import load
from camtopod.cli.events import Line, LineReader
from camtopod.cli.exits import InputError
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.predict import Predictor


def add_parser(subparsers: Any) -> None:
    """Add `predict`."""
    summary = "for each exit of recorded events, where the object appears next"
    parser = subparsers.add_parser("predict", help=summary, description=summary.capitalize() + ".")
    parser.add_argument("topology", metavar="TOPOLOGY.json", help="as `learn` writes it")
    parser.add_argument("events", metavar="EVENTS", help="event lines ('-': standard input)")


def run(args: argparse.Namespace) -> int:
    """One prediction line for each exit line, in input order; each uses only lines with an earlier
    time.
    """
    predictor = Predictor(load(args.topology))
    reader = LineReader()
    lines = list(reader.merged([args.events]))
    if reader.read and not lines:
        print(f"camtopod: {reader.summary()}", file=sys.stderr)
        raise InputError(f"no event lines in {args.events}: nothing to predict")
    by_time = sorted(range(len(lines)), key=lambda k: lines[k].event.t)
    answers: dict[int, bytes] = {}
    waiting: list[int] = []
    with Progress() as progress:
        for k in by_time:
            if waiting and lines[k].event.t > lines[waiting[0]].event.t:
                _observe(predictor, lines, waiting)
            if lines[k].event.kind == "exit":
                answers[k] = to_json(predictor.predict(lines[k].event))
            waiting.append(k)
            progress.show("%d exits predicted of %d lines", len(answers), len(lines))
    for k in sorted(answers):
        sys.stdout.buffer.write(answers[k] + b"\n")
    sys.stdout.buffer.flush()
    if (summary := reader.summary()) is not None:
        print(f"camtopod: {summary}", file=sys.stderr)
    return 0


def _observe(predictor: Predictor, lines: list[Line], waiting: list[int]) -> None:
    """Events of one moment become known only when time has moved on."""
    for k in waiting:
        predictor.observe(lines[k].event)
    waiting.clear()
