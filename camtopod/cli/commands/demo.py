"""`camtopod demo`: run the whole system on one machine without any configuration.

Simulated people walk past five rendered cameras. One real grabber per camera, each a process of its
own, reads its video at many times real time; the real daemon, in this process, learns from their
events over a real bus. The daemon runs on the demo's clock, so the recording looks like an ordinary
one that began a while ago.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
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

import numpy as np
from msgspec.structs import replace

from camtopod.cli import exits
from camtopod.cli.commands import web
from camtopod.cli.common import counted, open_output, say, until_signal, writing
from camtopod.cli.terminal import ProgressLine
from camtopod.codec import to_json
from camtopod.config import BusSettings, Config, Limits, SiteSettings, StateSettings, WebSettings
from camtopod.learn.settings import LearnSettings
from camtopod.records import Topology
from camtopod.serve.bus import dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.runtime import clock as clocks
from camtopod.sim.floor import Plan, Walk, demo_plan, passages, simulate_walks, truth_of
from camtopod.sim.picture import write_map
from camtopod.sim.rendering import SUFFIX, render
from camtopod.sim.scoring import score

WALKERS_PER_SECOND = 0.1
"""Mean number of people who come from the streets per second."""
MINUTES = 18.0
"""Default length of the recording."""
SITE = "demo"
"""Name of the site."""
AFTERWARDS_SECONDS = 3600.0
"""Jump of the demo's clock at the end of the recording, so that no more events are waited for."""
QUIET_SECONDS = 1.0
"""Everything counts as learned once no event has arrived for this long."""
PATIENCE_SECONDS = 60.0
"""The demo gives up when there has been no progress for this long."""


class DemoClock:
    """Clock of the demo's daemon: seconds since the epoch, from ``start`` on."""

    def __init__(self, start: float) -> None:
        self._start = start - time.monotonic()

    def __call__(self) -> float:
        return self._start + time.monotonic()

    def skip(self, seconds: float) -> None:
        """Advance the clock by ``seconds`` at once."""
        self._start += seconds


def add_parser(add: Any) -> None:
    """Add `demo`."""
    parser = add(
        description="Runs the whole system on one machine: simulated people, rendered cameras, "
        "real grabbers, a real bus and the real daemon. Writes the learned topology, the ground "
        "truth and a picture of both.",
        epilog="example: camtopod demo --out my-demo --minutes 18",
    )
    default_note = " (default: %(default)s)"
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("camtopod-demo"),
        metavar="DIR",
        help="directory for the results" + default_note,
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the simulated people; same site" + default_note
    )
    parser.add_argument(
        "--minutes", type=float, default=MINUTES, help="length of the recording" + default_note
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="show it all on a web page of this machine, until Ctrl-C",
    )


def run(args: argparse.Namespace) -> None:
    """Run the demo. Raises `exits.CommandError` if a part of it fails."""
    if not 1 <= args.minutes <= 600 or args.seed < 0:
        raise exits.CommandError(
            "demo: --minutes must be from 1 to 600, --seed 0 or more", exits.USAGE
        )

    # Record, play the recording to the system, and score the topology that it learns.
    begin = time.monotonic()
    with writing(args.out):
        args.out.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that nothing is left behind
    with tempfile.TemporaryDirectory(prefix="camtopod-demo-") as work:
        seconds = 60.0 * args.minutes
        plan = demo_plan()
        walks = simulate_walks(plan, seconds, WALKERS_PER_SECOND, np.random.default_rng(args.seed))
        truth = truth_of(plan, passages(plan, walks))
        videos = _rendered(Path(work), plan, walks, seconds, args.seed)
        with _watched(videos, seconds, Path(work), args.page) as (topology, address):
            result = score(topology, truth)

            # Write the results.
            for name, content in (("topology", topology), ("truth", truth)):
                with open_output(args.out / f"{name}.json") as file:
                    file.write(to_json(content) + b"\n")
            picture = args.out / "map.png"
            write_map(picture, plan, truth, topology, result.text().splitlines())
            print(result.text())
            files = f"picture in {picture}, topology in {args.out / 'topology.json'}"
            say(f"demo: {files}; {time.monotonic() - begin:.0f} s")
            if address:
                say(f"demo: open {address}, Ctrl-C ends it")
                with until_signal() as stop:
                    stop.wait()


def _rendered(
    work: Path, plan: Plan, walks: list[Walk], seconds: float, seed: int
) -> dict[str, Path]:
    """Render the video of every camera, of ``seconds`` length, on all cores; return the files."""
    videos = {view.camera: work / f"{view.camera}{SUFFIX}" for view in plan.views}

    # Render, a process per camera.
    say(f"demo: rendering {len(videos)} cameras, {seconds / 60:g} minutes, {len(walks)} people")
    context = multiprocessing.get_context("spawn")
    workers = min(len(videos), os.cpu_count() or 1)
    alone = (signal.SIGINT, signal.SIG_IGN)  # the parent ends them
    with ProcessPoolExecutor(workers, context, signal.signal, alone) as pool:
        tasks = [
            pool.submit(render, plan, view, walks, seconds, videos[view.camera], seed)
            for view in plan.views
        ]
        try:
            with ProgressLine() as progress:
                for count, task in enumerate(as_completed(tasks), 1):
                    task.result()
                    progress.show("rendered %d of %d cameras", count, len(tasks))
        finally:
            pool.shutdown(cancel_futures=True)
    return videos


@contextlib.contextmanager
def _watched(
    videos: dict[str, Path], seconds: float, work: Path, has_page: bool
) -> Iterator[tuple[Topology, str]]:
    """Play the videos to the grabbers while the daemon learns; yield the topology.

    With it the address of the page, which is there until the block ends; "" if there is none.
    """
    # The recording has just ended on the demo's clock, which is never ahead of this machine's.
    start = clocks.wall() - 2 * (seconds + AFTERWARDS_SECONDS)
    clock = DemoClock(start + seconds)

    # A free port; state and pictures in the work directory. The grabbers may be far apart.
    config = Config(
        site=SiteSettings(SITE),
        bus=BusSettings(listen=("tcp/127.0.0.1:0",)),
        state=StateSettings(str(work / "state")),
        learn=LearnSettings(lateness_seconds=seconds, refit_share=0.03),
        limits=Limits(settle_seconds=AFTERWARDS_SECONDS),
        web=WebSettings(pictures=str(work)),
    )

    # Play the videos to their end, then let the daemon learn the last events.
    with contextlib.ExitStack() as stack:
        daemon = stack.enter_context(Daemon(config, clock=clock))
        address = ""
        if has_page:
            reader = replace(config, bus=BusSettings(connect=(daemon.endpoint,)))
            # Ages on the page are those of the recording, whatever the daemon's clock skips.
            address = stack.enter_context(_page(reader, DemoClock(start + seconds)))
            say(f"demo: the page is at {address}")
        say("demo: playing the videos as fast as the grabbers read them")
        with _grabbers(videos, start, daemon.endpoint, work) as grabbers:
            _until(daemon, lambda _: _have_ended(grabbers))
        # The last events wait for the lateness and the end of their tick.
        clock.skip(AFTERWARDS_SECONDS + seconds + config.learn.version_seconds)
        _until(daemon, functools.partial(_has_learned, daemon))
        say(f"demo: {_progress(daemon)}")
        if daemon.topology is None:
            raise exits.CommandError("demo: no topology was learned; try more --minutes")
        yield daemon.topology, address


@contextlib.contextmanager
def _page(config: Config, clock: DemoClock) -> Iterator[str]:
    """Serve the page of the demo's daemon at a free port; yield its address."""
    from camtopod.web import app  # needs starlette and uvicorn

    host = "127.0.0.1"
    with (
        dial(config) as bus,
        web.listening(host, 0) as listener,
        app.serving(bus, listener, web.names(host), clock, config),
    ):
        yield f"http://{host}:{listener.getsockname()[1]}/"


@contextlib.contextmanager
def _grabbers(
    videos: dict[str, Path], start: float, endpoint: str, work: Path
) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run one `camtopod grab` process per camera; they end with the block, whatever happens."""
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for camera, video in videos.items():
            command = [sys.executable, "-m", "camtopod", "grab", "--camera", camera, str(video)]
            command += ["--start", repr(start)]
            command += ["--site", SITE, "--connect", endpoint, "--state", str(work / "spools")]
            command += ["--config", "none", "--log-level", "error"]
            processes[camera] = subprocess.Popen(command, stdin=subprocess.DEVNULL)
        yield processes
    finally:
        for grabber in processes.values():
            grabber.kill()
            grabber.wait()


def _have_ended(grabbers: dict[str, subprocess.Popen[bytes]]) -> bool:
    """Return True once all grabbers have ended. Raises `exits.CommandError` for one that failed."""
    for camera, grabber in grabbers.items():
        if grabber.poll() not in (0, None):
            raise exits.CommandError(
                f"demo: the grabber of {camera} ended with status {grabber.returncode}, see above"
            )
    return all(grabber.returncode == 0 for grabber in grabbers.values())


def _has_learned(daemon: Daemon, quiet: float) -> bool:
    """Return True once all events are learned and published, and nothing comes any more.

    quiet: seconds since the last change.
    """
    status = daemon.status()
    busy = status.events.waiting or status.learner.held
    is_published = status.learner.version == status.version
    return quiet >= QUIET_SECONDS and is_published and not busy


def _until(daemon: Daemon, is_done: Callable[[float], bool]) -> None:
    """Show progress until ``done(seconds since the last change)`` returns True.

    Raises `exits.CommandError` if there is no progress for `PATIENCE_SECONDS` or the daemon fails.
    """
    line = ""
    moved_at = time.monotonic()
    with ProgressLine(lines=True) as progress:
        while not is_done(time.monotonic() - moved_at):
            if daemon.wait(0.1):
                raise exits.CommandError("demo: the daemon has failed")
            before = line
            line = _progress(daemon)
            progress.show("%s", line)
            if line != before:
                moved_at = time.monotonic()
            elif time.monotonic() > moved_at + PATIENCE_SECONDS:
                raise exits.CommandError(
                    f"demo: no progress for {PATIENCE_SECONDS:g} s; is the machine too busy?"
                )


def _progress(daemon: Daemon) -> str:
    """Return one line about the events and the newest topology."""
    status = daemon.status()
    topology = daemon.topology
    events = f"{counted(len(status.cameras), 'camera')}, {counted(status.events.stored, 'event')}"
    if topology is None:
        return f"{events}, nothing learned yet"
    links = sum(link.relation != "visible" for link in topology.links)
    return (
        f"{events}, version {topology.version}: "
        f"{counted(len(topology.zones), 'zone')}, {counted(links, 'link')}, "
        f"{counted(len(topology.pairs), 'camera pair')}"
    )
