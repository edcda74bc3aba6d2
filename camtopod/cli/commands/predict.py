"""`camtopod predict`: for each exit of recorded events, predict where the object appears next.

With ``--walks``: for each entry, tell which earlier passages it may continue.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from typing import Any

from msgspec.structs import replace

from camtopod.cli import exits
from camtopod.cli.common import configuration, counted, topology_of
from camtopod.cli.events.event_lines import LineReader, open_input
from camtopod.cli.events.recording import (
    Survey,
    Times,
    fault_of,
    foreign_cameras,
    right_lines,
    timed,
)
from camtopod.cli.events.time_order import OrderedAnswers, Pipe
from camtopod.cli.exits import InputError
from camtopod.cli.terminal import ProgressLine
from camtopod.codec import to_json
from camtopod.predict import matching, predicting
from camtopod.records import Event, Kind, Match, Prediction


def add_parser(add: Any) -> None:
    """Add `predict`."""
    parser = add(
        description="Predicts for each exit of recorded events where the object appears next, and "
        "prints one prediction per line, in the order of the input. A pipe is answered as it is "
        "read: an exit when a line that is later by [learn] lateness_seconds has come, or no line "
        "comes for two seconds.",
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
        "events", metavar="EVENTS", help="file or pipe of event lines ('-': standard input)"
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


def run(args: argparse.Namespace) -> int:
    """Print a line for each exit (or entry) line, in input order; each uses only earlier events.

    A pipe is answered as it is read, and so is a file in order of time; another file is sorted
    first.
    """
    topology = topology_of(args.topology)
    kind: Kind = "entry" if args.walks else "exit"
    answer = matching(topology) if args.walks else predicting(topology)
    unit = "entries matched" if args.walks else "exits predicted"
    reader = LineReader()
    times = Times()
    out = sys.stdout.buffer
    cameras = Counter[str]()
    count = line_count = 0
    with open_input(args.events) as file, ProgressLine() as progress:

        def texts(moment: list[Event]) -> list[bytes]:
            nonlocal count
            count += sum(event.kind == kind for event in moment)
            cameras.update(event.camera for event in moment)
            progress.show(f"%d {unit} of %d lines", count, line_count or reader.lines_read)
            results = (result and shortened(result, args.top) for result in answer(moment))
            return [to_json(result) + b"\n" if result else b"" for result in results]

        is_recording = file.seekable()
        if is_recording:
            answers = OrderedAnswers(texts, kind, 0.0)
            begin = file.tell()
            survey = Survey()
            is_ordered, wrong = survey.look(args.events, file)
            line_count = survey.cameras.total()
            file.seek(begin)
            right = right_lines(reader, args.events, file, survey, wrong)
            events = timed((line.event for line in right), times)
            answer_lines = answers.of(events) if is_ordered else answers.of_unordered(events)
        else:
            answers = OrderedAnswers(texts, kind, configuration(args).learn.lateness_seconds)
            pipe = Pipe(file, out.flush, lambda: out.writelines(answers.rest()))
            answer_lines = answers.of(line.event for line in reader.lines(args.events, pipe))
        out.writelines(answer_lines)
        out.flush()

    if answers.late:
        message = f"{counted(answers.late, 'line')} came too late for answers before"
        print(f"camtopod: {message} ([learn] lateness_seconds); a file is sorted", file=sys.stderr)
    if (summary := reader.summary()) is not None:
        print(f"camtopod: {summary}", file=sys.stderr)
    if not reader.events and (reader.lines_read or is_recording):
        raise InputError(f"no event lines in {args.events}: nothing to predict")
    if is_recording and not count:
        raise InputError(f"no {kind} lines in {args.events}: nothing to predict")
    foreign_status = foreign_cameras(args.topology, topology, cameras)
    if (fault := fault_of(times)) is not None:
        print(f"camtopod: {fault}", file=sys.stderr)
        return exits.FAILED
    return reader.status or foreign_status


def shortened(answer: Prediction | Match, count_max: int | None) -> Prediction | Match:
    """Return an answer with the ``count_max`` likeliest outcomes.

    ``others`` or ``new`` has the rest.
    """
    if count_max is None:
        return answer
    if isinstance(answer, Match):
        remainder = sum(candidate.probability for candidate in answer.from_[count_max:])
        return replace(answer, from_=answer.from_[:count_max], new=answer.new + remainder)
    other_probabilities = [candidate.probability for candidate in answer.next[count_max:]]
    return replace(
        answer,
        next=answer.next[:count_max],
        others=sum(other_probabilities) if other_probabilities else None,
        look=answer.look and answer.look[:count_max],
        in_view=answer.in_view and answer.in_view[:count_max],
    )
