"""`camtopod demo`: run the whole system on one machine without any configuration.

Simulated people walk past five rendered cameras. One real grabber per camera, each a process of its
own, reads its video at many times real time; the real daemon, in this process, learns from their
events over a real bus. On a slow or busy machine grabbers fall behind, and the faster ones are
paused. The daemon runs on the demo's clock, so the recording looks like an ordinary one that began
a while ago.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from camtopod.cli import exits
from camtopod.cli.terminal import Progress
from camtopod.codec import to_json
from camtopod.config import BusSettings, Config, Limits, SiteSettings, StateSettings
from camtopod.learn import Settings
from camtopod.records import Topology
from camtopod.serve import Daemon
from camtopod.serve.bus import Bus, BusError, access, dial
from camtopod.serve.bus import session as buses
from camtopod.serve.runtime import clock as clocks
from camtopod.sim import (
    SUFFIX,
    Plan,
    Times,
    Truth,
    Walk,
    camera_times,
    demo_plan,
    passages,
    render,
    score,
    simulate_walks,
    truth_of,
    write_map,
)

WALKERS_PER_SECOND = 0.1
"""Mean number of people who come from the streets per second."""
MINUTES = 18.0
"""Default length of the recording."""
SITE = "demo"
"""Name of the site."""
SPEED = 60.0
"""Factor on the pace of the videos, if the machine is fast enough."""
AHEAD_SECONDS = 30.0
"""A grabber that is this much ahead of the last one, in event time, is paused."""
LATENESS_SECONDS = 180.0
"""Event time by which the grabbers may be apart.

It covers how far one may be ahead, how far it runs until that is noticed, and the time after which
a tracker gives up a lost object.
"""
AFTERWARDS_SECONDS = 3600.0
"""Jump of the demo's clock at the end of the recording, so that no more events are waited for."""
QUIET_SECONDS = 1.0
"""Everything counts as learned once no event has arrived for this long."""
PATIENCE_SECONDS = 60.0
"""The demo gives up when there has been no progress for this long."""
_TICK_SECONDS = 0.1
"""Interval at which progress is checked and, on a terminal, shown."""
_LINE_SECONDS = 2.0
"""Interval between lines of progress where standard error is no terminal."""


class Recording(Struct):
    """Simulated people, their ground truth, and the cameras' videos of ``seconds`` length."""

    plan: Plan
    walks: list[Walk]
    truth: Truth
    seconds: float
    videos: dict[str, Path]


class DemoClock:
    """Clock of the demo's daemon: seconds since the epoch, from ``start`` on, ``speed`` times as
    fast.
    """

    def __init__(self, start: float, speed: float) -> None:
        self._start, self._speed, self._begin = start, speed, time.monotonic()

    def __call__(self) -> float:
        return self._start + self._speed * (time.monotonic() - self._begin)

    def skip(self, seconds: float) -> None:
        """Advance the clock by ``seconds`` at once."""
        self._start += seconds


def add_parser(subparsers: Any) -> None:
    """Add `demo`."""
    parser = subparsers.add_parser(
        "demo",
        help="run the whole system on simulated cameras, without any configuration",
        description="Runs the whole system on one machine: simulated people, rendered cameras, "
        "real grabbers, a real bus and the real daemon. Writes the learned topology, the ground "
        "truth and a picture of both.",
        epilog="example: camtopod demo --out my-demo --minutes 18",
    )
    shown = " (default: %(default)s)"
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("camtopod-demo"),
        metavar="DIR",
        help="directory for the results" + shown,
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the simulated people; same site" + shown
    )
    parser.add_argument(
        "--minutes", type=float, default=MINUTES, help="length of the recording" + shown
    )
    parser.add_argument("--keep", action="store_true", help="also keep the videos and the state")


def run(args: argparse.Namespace) -> int:
    """Run the demo. Raises `exits.CommandError` if a part of it fails."""
    if not 1 <= args.minutes <= 600 or args.seed < 0:
        raise exits.CommandError(
            "demo: --minutes must be from 1 to 600, --seed 0 or more", exits.USAGE
        )

    # Record, play the recording to the system, and score the topology that it learns.
    begin = time.monotonic()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise exits.CommandError(f"demo: cannot write {args.out}: {error.strerror}") from None
    with _terminated_as_interrupted(), _work_directory(args.out, args.keep) as work:
        recording = _record(work, 60.0 * args.minutes, args.seed)
        topology = _watch(recording, work)
    result = score(topology, recording.truth)

    # Write the results.
    (args.out / "topology.json").write_bytes(to_json(topology) + b"\n")
    (args.out / "truth.json").write_bytes(to_json(recording.truth) + b"\n")
    picture = args.out / "map.png"
    write_map(
        picture,
        recording.plan,
        recording.walks,
        recording.truth,
        topology,
        result.text().splitlines(),
    )
    print("\n".join([*_table(recording.truth, topology), "", result.text()]))
    _say(
        f"picture in {picture}, topology in {args.out / 'topology.json'}; "
        f"{time.monotonic() - begin:.0f} s"
    )
    return exits.DONE


@contextlib.contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, so that no process or directory is left behind."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


@contextlib.contextmanager
def _work_directory(out: Path, keep: bool) -> Iterator[Path]:
    """Yield a directory for videos and state: inside ``out`` if ``keep``, else a temporary one."""
    if keep:
        yield Path(tempfile.mkdtemp(prefix="work-", dir=out))
        return
    with tempfile.TemporaryDirectory(prefix="camtopod-demo-", ignore_cleanup_errors=True) as name:
        yield Path(name)


def _record(work: Path, seconds: float, seed: int) -> Recording:
    """Simulate the walks, and render the video of every camera on all cores."""
    plan = demo_plan()
    walks = simulate_walks(plan, seconds, WALKERS_PER_SECOND, np.random.default_rng(seed))
    truth = truth_of(plan, passages(plan, walks))
    videos = {view.camera: work / f"{view.camera}{SUFFIX}" for view in plan.views}

    # Render, a process per camera.
    _say(f"rendering {len(videos)} cameras, {seconds / 60:g} minutes, {len(walks)} people")
    context = multiprocessing.get_context("spawn")
    workers = min(len(videos), os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, context, initializer=_leave_interrupts_to_the_parent) as pool:
        tasks = [
            pool.submit(render, plan, view, walks, seconds, videos[view.camera], seed)
            for view in plan.views
        ]
        try:
            with Progress() as progress:
                for count, task in enumerate(as_completed(tasks), 1):
                    task.result()
                    progress.show("rendered %d of %d cameras", count, len(tasks))
        finally:
            pool.shutdown(cancel_futures=True)
    return Recording(plan, walks, truth, seconds, videos)


def _leave_interrupts_to_the_parent() -> None:
    """Ignore SIGINT in a rendering process: the parent ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _watch(recording: Recording, work: Path) -> Topology:
    """Play the videos to the grabbers while the daemon learns; return the topology."""
    # Start the demo's clock early enough that no event lies in the future.
    start = clocks.wall() - 2 * (recording.seconds + AFTERWARDS_SECONDS)
    clock = DemoClock(start, SPEED)

    # The daemon's settings: a free port, and state in the work directory.
    config = Config(
        site=SiteSettings(SITE),
        bus=BusSettings(listen=("tcp/127.0.0.1:0",)),
        state=StateSettings(str(work / "state")),
        learn=Settings(lateness_seconds=LATENESS_SECONDS, refit_share=0.03),
        limits=Limits(future_seconds_max=AFTERWARDS_SECONDS, settle_seconds=recording.seconds),
    )

    # Play the videos to their end, then let the daemon learn the last events.
    try:
        with (
            _openness_said(config),
            Daemon(config, clock=clock) as daemon,
            dial(replace(config, bus=BusSettings(connect=(daemon.endpoint,)))) as bus,
            _grabbers(recording, start, daemon.endpoint, work) as grabbers,
        ):
            _say(f"playing the videos at up to {SPEED:g} times real time")
            _until(daemon, _Together(bus, grabbers, start))
            _check(grabbers, work)
            clock.skip(AFTERWARDS_SECONDS + recording.seconds)
            _until(daemon, _Learned(daemon))
            topology = daemon.topology
            late = daemon.status()["learner"]["late"]
            if late:
                _say(f"{late} events were too late and not learned: the machine was very busy")
    except BusError as error:
        raise exits.CommandError(f"demo: {error}", exits.BUS) from None
    if topology is None:
        raise exits.CommandError("demo: no topology was learned; try more --minutes")
    return topology


@contextlib.contextmanager
def _openness_said(config: Config) -> Iterator[None]:
    """Say once that the bus has no certificates, instead of the daemon's longer warning, in the
    block.
    """
    warning = access.openness_warning(config)
    log = logging.getLogger(buses.__name__)

    def other(record: logging.LogRecord) -> bool:
        return record.getMessage() != warning

    _say("the bus has no certificates: any program on this machine can use it until the demo ends")
    log.addFilter(other)
    try:
        yield
    finally:
        log.removeFilter(other)


@contextlib.contextmanager
def _grabbers(
    recording: Recording, start: float, endpoint: str, work: Path
) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run one `camtopod grab` process per camera; they end with the block, whatever happens."""
    environment = {
        **os.environ,
        "XDG_STATE_HOME": str(work),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    environment.pop("STATE_DIRECTORY", None)

    # Start them, each with a log file.
    running: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for camera, video in recording.videos.items():
            command = [sys.executable, "-m", "camtopod", "grab", "--camera", camera, str(video)]
            command += ["--start", repr(start), "--realtime", "--speed", repr(SPEED)]
            command += ["--site", SITE, "--connect", endpoint]
            with (work / f"{camera}.log").open("wb") as log:
                running[camera] = subprocess.Popen(
                    command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
                )
        yield running
    finally:
        # End them; a paused process has to continue to receive SIGTERM.
        for grabber in running.values():
            if grabber.poll() is None:
                grabber.terminate()
                grabber.send_signal(signal.SIGCONT)
        for grabber in running.values():
            try:
                grabber.wait(5.0)
            except subprocess.TimeoutExpired:
                grabber.kill()


def _check(grabbers: dict[str, subprocess.Popen[bytes]], work: Path) -> None:
    """Raise `exits.CommandError` for a grabber that failed, with its last lines of output."""
    for camera, grabber in grabbers.items():
        if grabber.poll() not in (0, None):
            said = (work / f"{camera}.log").read_text("utf-8", "replace").strip().splitlines()
            what = f"demo: the grabber of {camera} ended with status {grabber.returncode}"
            raise exits.CommandError(f"{what}: {' | '.join(said[-3:])}")


class _Together:
    """Return True once all grabbers have ended; until then, pause those that are ahead.

    Otherwise the events of slower grabbers would be late.
    """

    def __init__(
        self, bus: Bus, grabbers: dict[str, subprocess.Popen[bytes]], start: float
    ) -> None:
        self._grabbers = grabbers
        self._reached = dict.fromkeys(grabbers, start)
        self._held: set[str] = set()
        bus.subscribe("status/*", self._heard)

    def _heard(self, key: str, payload: bytes) -> None:
        """Note how far a grabber has come, from its status."""
        camera = key.removeprefix("status/")
        if camera in self._reached:
            self._reached[camera] = msgspec.msgpack.decode(payload).get(
                "last_frame_t", self._reached[camera]
            )

    def __call__(self) -> bool:
        running = [camera for camera, grabber in self._grabbers.items() if grabber.poll() is None]
        last = min((self._reached[camera] for camera in running), default=0.0)
        for camera in running:
            ahead = self._reached[camera] > last + AHEAD_SECONDS
            if ahead and camera not in self._held:
                self._held.add(camera)
                self._grabbers[camera].send_signal(signal.SIGSTOP)
            elif not ahead and camera in self._held:
                self._held.remove(camera)
                self._grabbers[camera].send_signal(signal.SIGCONT)
        return not running


class _Learned:
    """Return True once all events are learned and published and none has arrived for
    `QUIET_SECONDS`.
    """

    def __init__(self, daemon: Daemon) -> None:
        self._daemon, self._stored, self._since = daemon, -1, time.monotonic()

    def __call__(self) -> bool:
        status = self._daemon.status()
        events, learner = status["events"], status["learner"]
        known = (
            not events["waiting"]
            and not learner["held"]
            and learner["version"] == status["version"]
        )
        if events["stored"] != self._stored or not known:
            self._stored, self._since = events["stored"], time.monotonic()
        return time.monotonic() - self._since >= QUIET_SECONDS


def _until(daemon: Daemon, done: Callable[[], bool]) -> None:
    """Show progress until ``done()`` returns True.

    Raises `exits.CommandError` if there is no progress for `PATIENCE_SECONDS` or the daemon fails.
    """
    terminal = sys.stderr.isatty()
    begin, end, pause = ("\r\033[K", "", _TICK_SECONDS) if terminal else ("", "\n", _LINE_SECONDS)
    shown, line, moved = 0.0, "", time.monotonic()
    said = line

    while not done():
        if time.monotonic() > moved + PATIENCE_SECONDS:
            raise exits.CommandError(
                f"demo: no progress for {PATIENCE_SECONDS:g} s; is the machine too busy?"
            )
        if daemon.wait(_TICK_SECONDS):
            raise exits.CommandError("demo: the daemon has failed")
        before, line = line, _progress(daemon)
        if line != before:
            moved = time.monotonic()

        # Show the progress, less often where every line stays.
        if line != said and time.monotonic() - shown > pause:
            print(f"{begin}{line}", end=end, file=sys.stderr, flush=True)
            shown, said = time.monotonic(), line
    if terminal:
        print(file=sys.stderr)


def _progress(daemon: Daemon) -> str:
    """Return one line about the events and the newest topology."""
    status = daemon.status()
    topology = daemon.topology
    events = f"{len(status['cameras'])} cameras, {status['events']['stored']} events"
    if topology is None:
        return f"{events}, nothing learned yet"
    links = sum(link.relation != "visible" for link in topology.links)
    return (
        f"{events}, version {topology.version}: "
        f"{len(topology.zones)} zones, {links} links, {len(topology.pairs)} camera pairs"
    )


def _table(truth: Truth, topology: Topology) -> list[str]:
    """Return the true and the learned map as text, a pair of cameras per line."""
    camera = {zone.id: zone.camera for zone in truth.zones}
    true = camera_times(truth.links, camera)
    camera = {zone.id: zone.camera for zone in topology.zones}
    learned = camera_times(topology.links, camera)
    pairs = sorted({(min(key), max(key)) for key in [*true, *learned]})
    lines = [
        f"{'cameras':24}{'true map':32}learned map (mode of transit times, s, both directions)"
    ]
    lines += [
        f"{f'{a} - {b}':24}{_relation(true, a, b):32}{_relation(learned, a, b)}" for a, b in pairs
    ]
    return lines


def _relation(times: Times, a: str, b: str) -> str:
    """Return the relation of two cameras and the modes of their transit times in both
    directions.
    """
    ways = [times.get((a, b)), times.get((b, a))]
    if ways == [None, None]:
        return "-"
    relation = "overlapped" if any(way[0] for way in ways if way) else "unseen path"
    return f"{relation:12}" + " / ".join(f"{way[1]:5.1f}" if way else "    -" for way in ways)


def _say(text: str) -> None:
    print(f"demo: {text}", file=sys.stderr, flush=True)
