"""Helpers for tests of the daemon: small configurations, simulated events, waiting."""

from __future__ import annotations

import os
import random
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import msgspec
from paths import ROOT

from camtopod.config.settings import BusSettings, Config, Limits, StateSettings
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.serve.daemon import Daemon

T0 = 1_700_000_000.0
"""Event time at which the simulated walkers start."""
SPAN_SECONDS = 1200.0
"""Length of a simulated recording, seconds."""
WAIT_SECONDS = 60.0
"""Default timeout of waits, seconds."""
AT_ONCE = {"camtopod.serve.ingest.backlogs:SETTLE_SECONDS": 0.0}
"""Constant with which a daemon stores from its start on, and waits for no backlogs."""


def wait_for(
    condition: Callable[[], bool],
    what: str,
    seconds: float = WAIT_SECONDS,
    interval: float = 0.02,
) -> None:
    """Wait until ``condition()`` holds; on timeout fail with ``what`` was waited for."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited {seconds} s for {what}"
        time.sleep(interval)


def all_out(daemon: Daemon, events: int) -> bool:
    """Return True if the learner has had ``events`` events and its versions are published."""
    status = daemon.status()
    had = status.learner.accepted + status.learner.late == events
    return had and not status.events.waiting and status.learner.version == daemon.status().version


def free_endpoint() -> str:
    """Return a TCP endpoint on this machine that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def small_config(state: Path, connect: str | None = None, **limits: float) -> Config:
    """Return the configuration of a daemon on a free port, or of a client that dials ``connect``.

    The learner's lateness allows any order of arrival.
    """
    bus = BusSettings(listen=("tcp/127.0.0.1:0",))
    if connect:
        bus = BusSettings(connect=(connect,), connect_seconds=WAIT_SECONDS)
    return Config(
        bus=bus,
        state=StateSettings(str(state)),
        learn=Settings(lateness_seconds=2 * SPAN_SECONDS, refit_share=0.5),
        limits=Limits(**{"status_seconds": 0.1, **limits}),
    )


def walkers(count: int, seed: int = 1, seconds: float = SPAN_SECONDS) -> list[Event]:
    """Simulate objects that cross the view of ``a``, then that of ``b`` or ``c`` some seconds
    later.

    Events are in order of time.
    """
    chance = random.Random(seed)
    events = []
    for number in range(count):
        t = T0 + chance.uniform(0, seconds - 60)
        track = str(number)
        for camera, gap in (("a", 0.0), (chance.choice("bc"), chance.gauss(9, 1))):
            t += gap
            events.append(
                Event(camera, "entry", round(t, 3), 0.1 + 0.02 * chance.random(), 0.5, track)
            )
            t += chance.uniform(3, 6)
            events.append(
                Event(camera, "exit", round(t, 3), 0.9 - 0.02 * chance.random(), 0.5, track)
            )
    return sorted(events, key=lambda event: event.t)


def closing_event() -> Event:
    """Return an event so much later that everything before it is learned."""
    return Event("late", "entry", T0 + 10 * SPAN_SECONDS)


def numbered(events: list[Event], boot: str = "b1") -> list[Event]:
    """Return the events with boot and seq, counted per camera from 1."""
    seqs: dict[str, int] = {}
    result = []
    for event in events:
        seq = seqs[event.camera] = seqs.get(event.camera, 0) + 1
        result.append(msgspec.structs.replace(event, boot=boot, seq=seq))
    return result


def camtopod(
    *arguments: str, constants: Mapping[str, object] = MappingProxyType({}), **popen: object
) -> subprocess.Popen[bytes]:
    """Start the program in a process of its own.

    constants: see `program`.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, *program(constants), *arguments]
    return subprocess.Popen(command, env=environment, **popen)  # type: ignore[call-overload]


def program(constants: Mapping[str, object]) -> list[str]:
    """Return the arguments with which Python runs the program.

    constants: other values of "module:NAME", in that process alone.
    """
    if not constants:
        return ["-m", "camtopod"]
    lines = [
        f"import {module}; {module}.{name} = {value!r}"
        for (module, _, name), value in ((key.partition(":"), constants[key]) for key in constants)
    ]
    main = "import sys, camtopod.cli.main; sys.exit(camtopod.cli.main.main())"
    return ["-c", "\n".join([*lines, main])]


class Failing:
    """A connection whose COMMIT raises once, before or after it took effect."""

    def __init__(self, database: sqlite3.Connection, durable: bool) -> None:
        self._database, self._durable, self._failed = database, durable, False

    def __getattr__(self, name: str) -> object:
        return getattr(self._database, name)

    def execute(self, statement: str, *parameters: object) -> object:
        if statement == "COMMIT" and not self._failed:
            self._failed = True
            if self._durable:
                self._database.execute(statement)
            raise sqlite3.OperationalError("disk I/O error")
        return self._database.execute(statement, *parameters)
