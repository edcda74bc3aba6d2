"""Measure one daemon on large sites: an hour of events, then a fit beside live traffic.

    python -m bench scale [--cameras 100,1000] [--hours 1] [--rate 0.1] [--seconds 20]
                          [--json FILE]

The real `camtopod run` starts without state, with the limit that `deploy/large.md` raises, and
receives the events of a simulated network (``--rate`` events a second and camera) as fast as it
accepts them. Measured are the peak memory of the daemon and its learner, and their processor time
until everything is learned, all versions on the way included. Then events come at the site's own
rate for ``--seconds``, while one camera after another is forgotten, which starts a fit each time.
Measured are the processor time of a fit, and the time from exits to their predictions meanwhile.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from bench.support import ratios
from bench.support.clients import client, learned_status, result, status_of, write_events
from bench.support.parts import part_parser
from bench.support.site import children, peak_memory, processor_seconds, running
from camtopod.config.settings import BusSettings, Config
from camtopod.records import Event
from camtopod.serve.bus import dial
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

LEARN_SECONDS_MAX = 7_200.0
"""Longest wait for the learner, seconds."""
EVENTS_PER_OBJECT = 8.1
"""Events of an object that enters a simulated site, about."""
COLUMNS = "{:>8}{:>9}{:>10}{:>13}{:>9}{:>8}{:>12}{:>10}"
HEADER = COLUMNS.format(
    "cameras", "events", "versions", "processor s", "peak MB", "fit s", "median ms", "99 % ms"
)


class Size(Struct):
    """Figures of one size of site."""

    cameras: int
    events: int
    versions: int
    processor_seconds: float
    """Processor time of daemon and learner for all events."""
    memory_mb: float
    """Their peak memory, in 10^6 bytes."""
    fit_seconds: float
    """Processor time of a fit."""
    median_ms: float
    """Median time from an exit to its prediction beside a fit, milliseconds."""
    tail_ms: float
    """Its 99th percentile."""


def main(argv: Sequence[str]) -> int:
    """Measure, print the table, write the figures; return the exit status."""
    arguments = _parse(argv)
    sizes: list[Size] = []
    print(HEADER)
    for cameras in map(int, arguments.cameras.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            sizes.append(
                measure(Path(folder), cameras, arguments.hours, arguments.rate, arguments.seconds)
            )
        print(line(sizes[-1]), flush=True)
    if arguments.json is not None:
        costs = {
            f"{size.cameras} cameras": [1e3 * size.processor_seconds / size.events]
            for size in sizes
        }
        table = ratios.compare("processor time of an event", "ms", costs, next(iter(costs)))
        ratios.write(arguments.json, "scale", [table], sizes=msgspec.to_builtins(sizes))
    return 0


def measure(folder: Path, cameras: int, hours: float, rate: float, seconds: float) -> Size:
    """Measure a daemon on a simulated site."""
    objects = rate * cameras / EVENTS_PER_OBJECT
    events, _ = simulate(
        SimSettings(cameras=cameras, hours=hours, seed=1, objects_per_second=objects, start=0.0)
    )
    recording_file = write_events(folder / "recorded", events)
    live = write_events(folder / "live", last_of(events, seconds))
    names = sorted({event.camera for event in events})
    limits = f"cameras_max = {cameras + 100}"
    with running(folder, limits=limits) as (endpoint, pid), peak_memory(pid) as peak:
        # The recorded events.
        with client("deliver", folder, endpoint=endpoint, events=recording_file) as sender:
            result(sender)
        status = learned_status(endpoint, LEARN_SECONDS_MAX)
        cpu_seconds = processor_seconds(pid, *children(pid))

        # Fits beside live events.
        fits: list[float] = []
        with (
            client("hear", folder, endpoint=endpoint, bare=False) as ear,
            client("put_paced", folder, endpoint=endpoint, events=live, bare=False) as sender,
        ):
            to_forget = iter(names[: len(names) // 2])
            while sender.poll() is None and (camera := next(to_forget, None)) is not None:
                fits.append(fit(endpoint, pid, camera))
            result(sender)
            delays = sorted(result(ear)["ms"])
    if status.events.stored != len(events):
        raise RuntimeError(f"{len(events)} events were published, {status.events.stored} stored")
    return Size(
        cameras,
        len(events),
        status.learner.version,
        cpu_seconds,
        peak[0] / 1e6,
        sum(fits) / len(fits),
        delays[len(delays) // 2],
        delays[int(0.99 * len(delays))],
    )


def last_of(events: Sequence[Event], seconds: float) -> list[Event]:
    """Return the events of the last seconds, with times from 0."""
    first = events[-1].t - seconds
    return [
        msgspec.structs.replace(event, t=event.t - first) for event in events if event.t >= first
    ]


def fit(endpoint: str, pid: int, camera: str) -> float:
    """Forget a camera, and return the learner's processor seconds until the next version."""
    before = status_of(endpoint).learner.version
    cpu_seconds = processor_seconds(*children(pid))
    with dial(Config(bus=BusSettings(connect=(endpoint,)))) as bus:
        bus.query("admin/forget", {"camera": camera}, one=True)
    deadline = time.monotonic() + LEARN_SECONDS_MAX
    while status_of(endpoint).learner.version == before:
        if time.monotonic() > deadline:
            raise TimeoutError("the fit has not ended in time")
        time.sleep(0.05)
    return processor_seconds(*children(pid)) - cpu_seconds


def line(size: Size) -> str:
    """Return the table's line of a size."""
    return COLUMNS.format(
        size.cameras,
        size.events,
        size.versions,
        f"{size.processor_seconds:.0f}",
        f"{size.memory_mb:.0f}",
        f"{size.fit_seconds:.1f}",
        f"{size.median_ms:.1f}",
        f"{size.tail_ms:.1f}",
    )


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--cameras", default="100,1000", help="sizes of site, comma-separated")
    parser.add_argument(
        "--hours", type=float, default=1.0, help="length of the recordings (default 1)"
    )
    parser.add_argument(
        "--rate", type=float, default=0.1, help="events a second and camera (default 0.1)"
    )
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="seconds of live events (default 20)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    return parser.parse_args(argv)
