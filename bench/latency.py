"""Measure the time from an exit's publication to its prediction, beside a bare zenoh round trip.

    python -m bench latency [--cameras 100] [--rate 1000] [--seconds 20] [--rounds 5] [--json FILE]

Three processes with a session each: one publishes events, stamped with the moment of publication
and spaced as a simulated network's are; the second is the meeting point and answers each exit; the
third receives the answers. The second is the real `camtopod run` on a site that has learned, or a
bare session that answers with as many bytes. In ``refitting`` the learner fits all the time.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from bench.support import ratios, site
from bench.support.clients import client, learned_status, ready_at, result, status_of, write_events
from bench.support.parts import part_parser
from bench.support.site import learned_site, running, traffic
from camtopod.config import BusSettings, Config
from camtopod.records import Event
from camtopod.serve.bus import dial

BARE, QUIET, REFITTING = "bare zenoh", "daemon", "daemon, refitting"
"""Names of the contestants."""
LEARN = {
    QUIET: "refit_share = 1e9\nrefit_hours = 1e9",
    REFITTING: "refit_share = 1e-9\nrefit_hours = 1e9\nversion_seconds = 1.0",
}
"""Settings of the learner, by contestant."""
P50_MAX, P99_MAX, REFIT_P99_MAX = 3.0, 5.0, 2.0
"""Targets: p50 and p99 over those of bare zenoh; p99 during fits over p99 without fits."""


class Round(NamedTuple):
    """Milliseconds of every answer, their size in bytes, and the versions made meanwhile."""

    ms: list[float]
    size: int
    versions: int = 0

    def quantile(self, share: float) -> float:
        """Return a quantile of the answer times, milliseconds."""
        return sorted(self.ms)[min(int(share * len(self.ms)), len(self.ms) - 1)]


class Case:
    """The contestants and their rounds."""

    def __init__(
        self, folder: Path, state: Path, cameras: int, rate: float, seconds: float
    ) -> None:
        self._folder, self._state = folder, state
        events = traffic(cameras, rate, int(rate * seconds))
        self.exits = sum(event.kind == "exit" for event in events)
        self._events = write_events(folder / "events", events)
        self.rounds: dict[str, list[Round]] = {BARE: [], QUIET: [], REFITTING: []}
        self._size = 400

    def bare(self) -> float:
        """Measure bare zenoh; store the round and return its median, milliseconds."""
        with client("echo", self._folder, endpoint="tcp/127.0.0.1:0", size=self._size) as echo:
            return self._measure(BARE, ready_at(echo))

    def daemon(self, name: str) -> float:
        """Measure the daemon; store the round and return its median, milliseconds."""
        shutil.rmtree(self._folder / "state", ignore_errors=True)
        shutil.copytree(self._state, self._folder / "state")
        with running(self._folder, LEARN[name]) as (endpoint, _):
            before = learned_status(endpoint)
            wait_until_it_stores(endpoint)
            median = self._measure(name, endpoint)
            after = status_of(endpoint)
            self.rounds[name][-1] = self.rounds[name][-1]._replace(
                versions=after.learner.version - before.learner.version
            )
            print(f"    {name}: {after}")
        self._size = self.rounds[name][-1].size
        return median

    def _measure(self, name: str, endpoint: str) -> float:
        """Run one round: publish all events and time the answers."""
        bare = name == BARE
        with (
            client("hear", self._folder, endpoint=endpoint, bare=bare) as ear,
            client(
                "put_paced", self._folder, endpoint=endpoint, events=self._events, bare=bare
            ) as sender,
        ):
            sender_result = result(sender)
            receiver_result = result(ear)
        if len(receiver_result["ms"]) < self.exits:
            print(f"    {name}: {self.exits} exits but only {len(receiver_result['ms'])} answers")
        turn = Round(receiver_result["ms"], receiver_result["size"])
        tail = " ".join(
            f"p{100 * share:g} {turn.quantile(share):.2f}" for share in (0.5, 0.9, 0.99, 0.999)
        )
        late = sender_result["late_ms"]
        print(f"    {name}: {tail} ms, {turn.size} bytes, published {late:.2f} ms late", flush=True)
        self.rounds[name].append(turn)
        return turn.quantile(0.5)


def wait_until_it_stores(endpoint: str) -> None:
    """Wait until the daemon stores events; in its first seconds it waits for backlogs."""
    with dial(Config(bus=BusSettings(connect=(endpoint,)))) as bus:
        bus.publish("event/probe", Event("probe", "entry", 0.0), "event")
        while not status_of(endpoint).events.stored:
            time.sleep(0.1)


def main(argv: list[str]) -> int:
    """Measure and return the exit status."""
    parser = part_parser(__name__, __doc__)
    site.add_arguments(parser)
    parser.add_argument(
        "--rate", type=float, default=1000.0, help="events a second, half of them exits"
    )
    parser.add_argument("--seconds", type=float, default=20.0)
    ratios.add_arguments(parser, rounds=5)
    arguments = parser.parse_args(argv)

    # Rounds of each contestant in turns.
    with tempfile.TemporaryDirectory() as name:
        state = learned_site(arguments.site or Path(name), arguments.cameras, arguments.learned)
        case = Case(Path(name), state, arguments.cameras, arguments.rate, arguments.seconds)
        ways: dict[str, Callable[[], float]] = {
            QUIET: partial(case.daemon, QUIET),
            REFITTING: partial(case.daemon, REFITTING),
            BARE: case.bare,
        }
        p50 = ratios.take_turns(ways, arguments.rounds)

    # Compare.
    p99 = {
        name: [turn.quantile(0.99) for turn in case.rounds[name][ratios.WARM_ROUNDS :]]
        for name in p50
    }
    fitting = {name: p99[name] for name in (QUIET, REFITTING)}
    tables = [
        ratios.compare("median", "ms", p50, BARE, {QUIET: P50_MAX}),
        ratios.compare("99th percentile", "ms", p99, BARE, {QUIET: P99_MAX}),
        ratios.compare(
            "99th percentile, while fitting anew", "ms", fitting, QUIET, {REFITTING: REFIT_P99_MAX}
        ),
    ]
    for table in tables:
        print("\n".join(ratios.lines(table)))
    versions = [turn.versions for turn in case.rounds[REFITTING]]
    print(f"versions made while measuring, a round: {min(versions)} .. {max(versions)}")
    ratios.write(
        arguments.json,
        "latency",
        tables,
        cameras=arguments.cameras,
        rate=arguments.rate,
        versions=versions,
    )
    return 0
