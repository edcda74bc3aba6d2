"""Measure the daemon's rate of events, beside zenoh + msgspec that only receive and decode.

    python -m bench ingest [--cameras 100] [--events 200000] [--rounds 5] [--json FILE]

One process publishes, another receives. The receiver is the real `camtopod run`: it orders,
journals, answers, learns and predicts. A round is valid only if every event published has been
stored once. The site has learned before. ``no version due`` leaves out the learner's fits. ``a
version a minute`` has them, by default settings: 50 events of a camera stand for a second of event
time, as with a backlog.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from functools import partial
from pathlib import Path

from bench.support import ratios, site
from bench.support.clients import client, learned_status, ready_at, result, status_of, write_events
from bench.support.site import learned_site, running, traffic

BARE, QUIET, FITTING = (
    "zenoh + msgspec, doing nothing",
    "daemon, no version due",
    "daemon, a version a minute",
)
"""Names of the contestants."""
NEVER = "refit_share = 1e9\nrefit_hours = 1e9"
"""Settings with which no version falls due."""
COST_MAX = 4.0
"""Target: at least a quarter of the bare rate."""
EVENTS_PER_SECOND_PER_CAMERA = 50.0
"""Density of the traffic in event time, events a second and camera."""


class Lost(RuntimeError):
    """Raised if not every published event has been stored."""


def main(argv: list[str]) -> int:
    """Measure and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m bench ingest", description="Measure the daemon's rate of events."
    )
    site.add_arguments(parser)
    parser.add_argument("--events", type=int, default=200_000)
    ratios.add_arguments(parser, rounds=5)
    given = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        learned = learned_site(given.site or folder, given.cameras, given.learned)
        events = write_events(
            folder / "events",
            traffic(given.cameras, EVENTS_PER_SECOND_PER_CAMERA * given.cameras, given.events),
        )
        costs = ratios.take_turns(
            {
                BARE: partial(bare, folder, events, given.events),
                QUIET: partial(daemon, folder, learned, events, given.events, NEVER),
                FITTING: partial(daemon, folder, learned, events, given.events, ""),
            },
            given.rounds,
        )
    at_most = {QUIET: COST_MAX, FITTING: COST_MAX}
    table = ratios.compare(
        f"{given.events} events of {given.cameras} cameras", "us an event", costs, BARE, at_most
    )
    print("\n".join(ratios.lines(table)))
    for row in table.rows:
        print(
            f"  {row.name}: {1e6 / row.cost.median:,.0f} events/s, "
            f"{1 / row.ratio.median:.2f} of the bare rate"
        )
    if given.json:
        ratios.write(given.json, "ingest", [table], cameras=given.cameras, events=given.events)
    return 0


def bare(folder: Path, events: str, count: int) -> float:
    """Return the microseconds an event that is received, decoded and dropped."""
    with client("sink", folder, endpoint="tcp/127.0.0.1:0") as sink:
        endpoint = ready_at(sink)
        with client("put_flood", folder, endpoint=endpoint, events=events) as sender:
            sent = result(sender)
        received = result(sink)["received"]
    if received != count:
        raise Lost(f"{count} events were published and {received} received")
    return float(1e6 * sent["seconds"] / count)


def daemon(folder: Path, learned: Path, events: str, count: int, learn: str) -> float:
    """Return the microseconds an event until it is stored."""
    shutil.rmtree(folder / "state", ignore_errors=True)
    shutil.copytree(learned, folder / "state")
    with running(folder, learn) as (endpoint, _):
        learned_status(endpoint)
        with client("deliver", folder, endpoint=endpoint, events=events) as sender:
            sent = result(sender)
        status = status_of(endpoint)
    if status.events.stored != count:
        raise Lost(f"{count} events were published and {status.events.stored} stored: {status}")
    print(f"    {1e6 * sent['seconds'] / count:.1f} us; {status}", flush=True)
    return float(1e6 * sent["seconds"] / count)
