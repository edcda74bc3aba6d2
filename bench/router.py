"""Measure the cost of a router between the cameras and the daemons of a site.

    python -m bench router [--cameras 100] [--events 200000] [--readers 1,4] [--rounds 3]
                           [--json FILE]

One process publishes events as fast as they are accepted. A router forwards them to a number of
readers, which each receive all events and drop them. Measured is the router's processor time per
forwarded message, and its ratio to that with one reader. The router is a zenoh session in mode
``router``, as the daemon's own is; zenohd runs the same code.
"""

from __future__ import annotations

import contextlib
import tempfile
from functools import partial
from pathlib import Path

from bench.ingest import EVENTS_PER_SECOND_PER_CAMERA, Lost
from bench.support import ratios
from bench.support.clients import client, ready_at, result, write_events
from bench.support.parts import part_parser
from bench.support.site import traffic


def main(argv: list[str]) -> int:
    """Measure and return the exit status."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument("--events", type=int, default=200_000)
    parser.add_argument("--readers", default="1,4", help="numbers of readers, comma-separated")
    ratios.add_arguments(parser, rounds=3)
    arguments = parser.parse_args(argv)
    counts = [int(count) for count in arguments.readers.split(",")]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rate = EVENTS_PER_SECOND_PER_CAMERA * arguments.cameras
        events = write_events(folder / "events", traffic(arguments.cameras, rate, arguments.events))
        costs = ratios.take_turns(
            {
                _name(count): partial(passed_on, folder, events, arguments.events, count)
                for count in counts
            },
            arguments.rounds,
        )
    table = ratios.compare(
        f"{arguments.events} events passed on", "us a message", costs, _name(counts[0])
    )
    print("\n".join(ratios.lines(table)))
    for row in table.rows:
        print(f"  {row.name}: {1e6 / row.cost.median:,.0f} messages a second of a core")
    ratios.write(
        arguments.json, "router", [table], cameras=arguments.cameras, events=arguments.events
    )
    return 0


def passed_on(folder: Path, events: str, count: int, readers: int) -> float:
    """Return the microseconds of the router's processor time for each message to a reader."""
    with (
        client("router", folder, endpoint="tcp/127.0.0.1:0") as router,
        contextlib.ExitStack() as stack,
    ):
        endpoint = ready_at(router)
        sinks = [
            stack.enter_context(client("sink", folder, endpoint=endpoint, dials=True))
            for _ in range(readers)
        ]
        with client("put_flood", folder, endpoint=endpoint, events=events) as sender:
            result(sender)
        counts = [result(sink)["received"] for sink in sinks]
        cpu_seconds = result(router)["cpu_seconds"]
    if counts != [count] * readers:
        raise Lost(f"{count} events were published and {counts} received")
    return float(1e6 * cpu_seconds / (count * readers))


def _name(readers: int) -> str:
    return f"{readers} reader" + ("s" if readers > 1 else "")
