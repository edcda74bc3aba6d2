"""Measure how long the daemon takes to be ready again after a kill.

    python -m bench restart [--events 50000] [--behind 2000] [--times 5]

The journal of a simulated site of 12 cameras has ``--events`` events; the last ``--behind`` of them
are not in the snapshot and have to be learned again. The real `camtopod run` is started on it,
timed until it receives events, and killed.
"""

from __future__ import annotations

import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from bench.support.figures import line_of
from bench.support.parts import part_parser
from camtopod.codec import to_json, to_msgpack
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import pack
from camtopod.records import Event
from camtopod.serve.runtime.clock import ulid
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

SETTINGS = Settings(refit_share=0.9, refit_hours=100.0)
"""Few versions, so that the site is soon prepared; the state is as large as with many."""
OBJECTS_PER_SECOND, EVENTS_PER_HOUR = 0.12, 3500.0
"""Traffic of the simulated site, and the events an hour that it leads to, about."""


def main(argv: list[str]) -> int:
    """Measure and return the exit status."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--events", type=int, default=50_000)
    parser.add_argument("--behind", type=int, default=2_000)
    parser.add_argument("--times", type=int, default=5)
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        hours = arguments.events / EVENTS_PER_HOUR + 1.0
        events, _ = simulate(
            SimSettings(seed=1, objects_per_second=OBJECTS_PER_SECOND, hours=hours)
        )
        size = lay_out(Path(folder), events[: arguments.events], arguments.behind)
        config = Path(folder) / "camtopod.toml"
        config.write_text(
            f'[bus]\nlisten = ["tcp/127.0.0.1:0"]\n[state]\ndirectory = "{folder}/state"\n'
            f"[learn]\nrefit_share = {SETTINGS.refit_share}\nrefit_hours = {SETTINGS.refit_hours}\n"
        )
        seconds = [start(config) for _ in range(arguments.times)]
    print(f"snapshot {size / 1e6:.2f} MB, {arguments.behind} entries behind it")
    print(
        f"ready after {statistics.median(seconds):.2f} s (median of {len(seconds)}), "
        f"{max(seconds):.2f} s at most"
    )
    print(line_of("ready after", statistics.median(seconds)))
    return 0


def lay_out(folder: Path, events: Sequence[Event], behind: int) -> int:
    """Write the journal of a daemon that has learned all but the last ``behind`` events.

    Returns the size of the snapshot, bytes.
    """
    epoch = ulid(events[0].t)
    learner = Learner(SETTINGS, "site", epoch)
    for event in events[: len(events) - behind]:
        learner.receive(event)
    journal = Journal(folder / "state")
    journal.set_meta("epoch", epoch)
    journal.commit(
        [Entry("event", event.camera, None, None, to_msgpack(event)) for event in events]
    )

    # Versions, and the snapshot behind which the last events lie.
    versions = learner.updates()
    journal.commit([], [StoredVersion(v.epoch, v.version, v.digest, to_json(v)) for v in versions])
    state = pack(learner.save())
    journal.commit([], snapshot=Snapshot(len(events) - behind, epoch, state))
    journal.close()
    return len(state)


def start(config: Path) -> float:
    """Return the seconds until `camtopod run` is ready, and kill it."""
    begin = time.perf_counter()
    command = [sys.executable, "-m", "camtopod", "--config", str(config), "run"]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        line = b""
        while b"ready at" not in line:
            line = process.stderr.readline()
            if not line:
                raise RuntimeError("the daemon ended before it was ready")
        seconds = time.perf_counter() - begin
        process.send_signal(signal.SIGKILL)
    return seconds
