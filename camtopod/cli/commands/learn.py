"""`camtopod learn`: learn the topology from recorded event lines, as the daemon does.

With ``--updates`` every version that the daemon would have published is learned, each with a fit of
its own; otherwise only the last one, in one fit of the last window.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from typing import Any

from camtopod.cli import exits
from camtopod.cli.city import learn_city
from camtopod.cli.common import configuration, open_output
from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.events.learning import feed
from camtopod.cli.events.recording import Times, cameras_in_words, fault_of
from camtopod.cli.exits import InputError
from camtopod.cli.terminal import busiest_links, topology_lines
from camtopod.codec import to_json
from camtopod.event_time import utc_text
from camtopod.labels import LABELS_MAX
from camtopod.learn.learner import Learner
from camtopod.records import Topology
from camtopod.topology import lacks_in_words, likely_links

EPOCH = "recording"
"""Epoch of a topology learned from files, constant so that the same files give the same bytes."""


def add_parser(add: Any) -> None:
    """Add `learn`."""
    about = (
        "Learns the topology from recorded event lines with the daemon's learner: in one fit of "
        "the last window or, with --updates, with every version that the daemon would have "
        "published on the way, which takes many times as long. The single fit has a version count "
        "and zone numbers of its own, and has no score of its predictions and no clock changes, "
        "which only several versions show."
    )
    parser = add(
        description=about, epilog="example: camtopod learn events.jsonl --topology topology.json"
    )
    parser.add_argument(
        "events",
        nargs="+",
        metavar="EVENTS",
        help="files of event lines, or tables (CSV, Parquet, Excel ...) with the columns camera, "
        "kind, t (seconds since 1970, or ISO 8601), and x, y and track if known, in any order "
        "('-': standard input)",
    )
    parser.add_argument(
        "--topology",
        metavar="OUT.json",
        help="write the final topology to this file ('-': standard output)",
    )
    parser.add_argument(
        "--updates", metavar="OUT.jsonl", help="write every version to this file, one a line"
    )
    parser.add_argument(
        "--table",
        action="store_true",
        help="print the links between views, and those with half of their evidence; a terminal "
        "gets them anyway if no file is named",
    )
    learn_city.add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Learn; write the topology to a file, or to standard output if no file is named.

    A terminal gets its links as a table instead, as with ``--table``.
    """
    if args.districts or args.scheduler or args.insecure:
        return learn_city.run(args)
    config = configuration(args)
    reader = LineReader()
    times = Times()
    to_stdout = not (args.updates or args.table or sys.stdout.isatty())
    out = args.topology or ("-" if to_stdout else None)

    # Feed all events to the learner, and write the topology.
    with ExitStack() as stack:
        output = stack.enter_context(open_output(out)) if out else None
        learner = Learner(
            config.learner, site=config.site.name, epoch=EPOCH, only_last=args.updates is None
        )
        updates = stack.enter_context(open_output(args.updates)) if args.updates else None
        feed(learner, reader, args.events, times, updates)
        if (summary := reader.summary()) is not None:
            print(f"camtopod: {summary}", file=sys.stderr)
        if left_out := learner.statistics()["labels_left_out"]:
            message = f"the {LABELS_MAX} most frequent labels count, {left_out} others as none"
            print(f"camtopod: {message}", file=sys.stderr)
        topology = learner.topology
        if topology is None:
            raise InputError(f"no event lines in {', '.join(args.events)}: nothing to learn")
        if output is not None:
            output.write(to_json(topology) + b"\n")

    # Print the links, unless standard output is the topology's.
    if out != "-" and (args.table or not (out or args.updates)):
        print("\n".join(link_table(topology)))
    if not (out or args.updates):
        print("camtopod: --topology OUT.json keeps the topology", file=sys.stderr)
    repeats = [alarm for alarm in topology.alarms or [] if alarm.kind == "camera_repeats"]
    fault = fault_of(times)
    absent = sorted(times.cameras - {camera.id for camera in topology.cameras})
    if absent and not fault:
        print(
            f"camtopod: the window that ends {utc_text(topology.as_of)} has no events of "
            f"{cameras_in_words(absent)}: is a clock wrong?",
            file=sys.stderr,
        )
    for line in (
        *([fault] if fault else topology_lines(topology)),
        *(f"{alarm.subject} {alarm.detail}" for alarm in repeats),
    ):
        print(f"camtopod: {line}", file=sys.stderr)
    return exits.FAILED if fault else reader.status


def link_table(topology: Topology) -> list[str]:
    """Return the links between views as a table, busiest first, then those half-way to one."""
    rows = [["FROM", "TO", "RELATION", "PROBABILITY", "10 %", "TRANSIT (s)", "90 %", "EVIDENCE"]]
    for link in [*busiest_links(topology), *likely_links(topology)]:
        times = (link.transit.q10, link.transit.q50, link.transit.q90)
        figures = [f"{link.probability:.2f}", *(f"{seconds:.1f}" for seconds in times)]
        evidence = (
            f"lacks {lacks_in_words(link.lacks)}" if link.lacks else f"q = {link.q_value:.1g}"
        )
        evidence += ", contradicts not_neighbours" * link.contradicted
        rows.append([link.from_, link.to, link.relation, *figures, evidence])

    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    form = "  ".join(f"{{:{side}{width}}}" for side, width in zip("<<<>>>><", widths, strict=True))
    return [form.format(*row).rstrip() for row in rows]
