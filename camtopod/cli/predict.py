"""`camtopod predict`: for each exit of recorded events, where the object will appear next."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from camtopod import codec
from camtopod.cli.exits import InputError
from camtopod.cli.lines import Line, LineReader
from camtopod.cli.progress import Progress
from camtopod.codec import Rejected, to_json
from camtopod.learn.predict import Predictor
from camtopod.records import Topology


def add_parser(subparsers: Any) -> None:
    """Add `predict`."""
    summary = "for each exit of recorded events, where the object appears next"
    parser = subparsers.add_parser("predict", help=summary, description=summary.capitalize() + ".")
    parser.add_argument("topology", metavar="TOPOLOGY.json", help="as `learn` writes it")
    parser.add_argument("events", metavar="EVENTS", help="event lines ('-': standard input)")


def run(args: argparse.Namespace) -> int:
    """One prediction line for each exit line, in input order; each uses only lines with an earlier time."""
    predictor = Predictor(read_topology(args.topology))
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


def read_topology(path: str) -> Topology:
    """A topology file. Raises `InputError` when it cannot be read or is not one."""
    try:
        return codec.read_topology(Path(path).read_bytes())
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from None
    except Rejected as error:
        raise InputError(f"{path} is not a topology: {error}") from None
