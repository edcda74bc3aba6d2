"""A whole site of processes that can be killed: a router, the daemon, a publisher per camera."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import traffic
from grabber import stored
from real_daemon import READY_SECONDS, RealDaemon, status_over
from serving import free_endpoint, wait_for

from camtopod import codec
from camtopod.cli import exits
from camtopod.config.settings import BusSettings, Config, parse
from camtopod.learn.learner import Learner
from camtopod.records import Event, Topology
from camtopod.serve.bus.session import Bus, dial

HERE = Path(__file__).parent
OUTAGE_SECONDS_MAX = 60.0
"""Longest delay of an event by any fault, so that the order of arrival does not matter."""
LEARNER = "learner"
"""Name of the daemon's learner process.

It can be killed alone; the daemon then ends and is started again.
"""


class Site:
    """``count`` objects in ``span`` seconds of event time, played ``speed`` times faster.

    ``at_daemon`` and ``at_publishers`` are the endpoints that these dial (the router's, or a
    proxy's). Without spools the publishers publish each event once and forget it.
    """

    def __init__(
        self, directory: Path, count: int, span: float, speed: float, spools: bool = True
    ) -> None:
        self.directory = directory
        self.count = count
        self.span = span
        self.speed = speed
        self.spools = spools
        self.events = traffic.crossings(count, span)
        self.router_endpoint = free_endpoint()
        self.at_daemon = self.at_publishers = self.router_endpoint
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._daemon: RealDaemon | None = None
        self.began = 0.0
        self._bus: Bus | None = None
        self.versions: dict[tuple[str, int], str] = {}
        self.newest: list[tuple[str, int]] = []

    # --- processes ------------------------------------------------------------------------------

    def start(self, name: str) -> None:
        """Start ``router``, ``daemon`` or the publisher of a camera."""
        name = _program(name)
        if name == "router":
            process = self._python("router.py", self.router_endpoint, stdout=subprocess.PIPE)
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
        elif name == "daemon":
            self._daemon = RealDaemon(self.directory, self.daemon_toml())
            process = self._daemon.process
        else:
            spool = str(self.directory / f"spool-{name}.db") if self.spools else "-"
            given = (name, self.count, self.span, self.speed, self.began)
            process = self._python("traffic.py", self.at_publishers, spool, *map(str, given))
        self.processes[name] = process

    def start_all(self) -> None:
        """Start all processes, and a subscriber to the versions."""
        self.start("router")
        self.start("daemon")
        self._bus = dial(Config(bus=BusSettings(connect=(self.router_endpoint,))))
        self._bus.subscribe("topology", self._on_topology)
        self.began = time.time()
        for camera in traffic.CAMERAS:
            self.start(camera)

    def kill(self, name: str) -> None:
        """Kill a process with SIGKILL."""
        program = _program(name)
        process = self.processes[program]
        if name == LEARNER:
            os.kill(_child(process.pid), signal.SIGKILL)
            assert process.wait(READY_SECONDS) == exits.FAILED
        else:
            process.kill()
        self._close(program)

    def running(self, name: str) -> bool:
        """Return True if a process has not ended by itself."""
        program = _program(name)
        return program in self.processes and self.processes[program].poll() is None

    def finish(self, seconds: float = 600.0) -> dict[str, Any]:
        """Wait until all events are stored and learned, and end the daemon.

        Returns the daemon's last status.
        """
        for camera in traffic.CAMERAS:
            process = self.processes[camera]
            assert process.wait(seconds) == 0
        assert self._bus is not None
        for camera in (traffic.AFTER, "other"):  # event time follows the second camera
            count = self.status()["events"]["stored"]
            self._bus.publish(f"event/{camera}", traffic.last_event(self.span, camera), "event")
            wait_for(lambda n=count: self.status()["events"]["stored"] > n, "the last event")  # type: ignore[misc]
        wait_for(lambda: all_learned(self.status()), "the learner", seconds)
        status = self.status()
        if newest := status["version"]:  # while the daemon can still be queried for it
            wait_for(lambda: self.has_heard(newest), "the newest version to be heard")
        self.processes["daemon"].terminate()
        assert self.processes["daemon"].wait(30.0) == 0
        return status

    def close(self) -> None:
        """End all processes."""
        for name, process in list(self.processes.items()):
            process.kill()
            self._close(name)
        if self._bus is not None:
            self._bus.close()

    def await_flow(self) -> None:
        """Wait until more events are stored, or all publishers have ended."""
        before = self.status()["events"]["stored"]

        def flows() -> bool:
            return bool(self.status()["events"]["stored"] > before) or not any(
                map(self.running, traffic.CAMERAS)
            )

        wait_for(flows, "events to get through", 60.0)

    def restart(self, name: str, seconds: float) -> None:
        """End a process cleanly, and start it again after ``seconds``."""
        self.processes[name].terminate()
        self._close(name)
        time.sleep(seconds)
        self.start(name)

    # --- results ----------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        assert self._bus is not None
        return status_over(self._bus)

    def journal(self) -> list[Event]:
        """Return all events in the journal, except the closing ones."""
        events = [codec.event_from_msgpack(raw) for _, raw in stored(self.directory / "state")]
        return [event for event in events if event.camera in traffic.CAMERAS]

    def lost_and_doubled(self) -> tuple[int, int]:
        """Return the numbers of lost and of duplicated events in the journal."""
        found, made = Counter(map(_key, self.journal())), Counter(map(_key, self.events))
        return (made - found).total(), (found - made).total()

    def expected(self) -> dict[int, str]:
        """Return version -> digest of an uninterrupted learner over the same events."""
        learner = Learner(parse(self.daemon_toml()).learn, "site", "any")
        digests = {}
        for event in [
            *self.events,
            traffic.last_event(self.span),
            traffic.last_event(self.span, "other"),
        ]:
            learner.receive(event)
            digests |= {version.version: version.digest for version in learner.updates()}
        return digests

    def daemon_toml(self) -> str:
        """Return the daemon's configuration."""
        return (
            f'[bus]\nconnect = ["{self.at_daemon}"]\nconnect_seconds = 30.0\n'
            f"[learn]\nlateness_seconds = {OUTAGE_SECONDS_MAX * self.speed}\nrefit_share = 0.5\n"
            "[limits]\nstatus_seconds = 0.5\n"
        )

    def has_heard(self, newest: int) -> bool:
        """Return True if a version was received; if not, query the newest one.

        A version that is published while the subscriber's connection is made anew is never received
        otherwise.
        """
        if all(version != newest for _, version in self.versions):
            for _, payload in self._bus.query("topology"):
                self._note(payload)
        return any(version == newest for _, version in self.versions)

    def _on_topology(self, key: str, payload: bytes) -> None:
        self.newest.append(self._note(payload))

    def _note(self, payload: bytes) -> tuple[str, int]:
        """Note the digest of a version, which never has two; return its epoch and number."""
        topology = codec.read(Topology, payload, pack=True)
        version = (topology.epoch, topology.version)
        assert self.versions.setdefault(version, topology.digest) == topology.digest
        return version

    def _python(self, script: str, *arguments: str, **popen: Any) -> subprocess.Popen[bytes]:
        path = os.pathsep.join(str(folder) for folder in (HERE.parent.parent, HERE.parent, HERE))
        return subprocess.Popen(
            [sys.executable, str(HERE / script), *arguments],
            env={**os.environ, "PYTHONPATH": path},
            **popen,
        )

    def _close(self, name: str) -> None:
        """Wait for the end of a process, and close its pipe."""
        process = self.processes.pop(name)
        process.wait()
        if name == "daemon":
            assert self._daemon is not None
            self._daemon.close()
        elif process.stdout is not None:
            process.stdout.close()


def kill_and_restart(
    site: Site, kills: int, seed: int, groups: Sequence[Sequence[str]], say: Callable[[str], None]
) -> Counter[str]:
    """Kill and restart processes of random groups at random moments; return the kills by name.

    Between two kills some events are stored.
    """
    chance = random.Random(seed)
    killed: Counter[str] = Counter()
    while killed.total() < kills:
        alive = [name for name in chance.choice(groups) if site.running(name)]
        if not alive:
            continue
        name = chance.choice(alive)
        time.sleep(chance.uniform(0.0, 0.7))
        site.kill(name)
        killed[name] += 1
        time.sleep(chance.choice((0.0, chance.uniform(0.0, 1.0))))
        site.start(name)
        site.await_flow()
        say(f"{killed.total()} {name}")
    return killed


def all_learned(status: dict[str, Any]) -> bool:
    """Return True if the learner has reached the end of the journal and its versions are published.

    The journal must hold events only.
    """
    learner = status["learner"]
    taken = learner["accepted"] + learner["late"]
    at_end = taken == status["journal"]["entries"] and learner["held"] <= 2
    return bool(at_end and status["version"] == learner["version"])


def _program(name: str) -> str:
    """Return the program that a process belongs to."""
    return "daemon" if name == LEARNER else name


def _child(pid: int) -> int:
    """Return the id of a daemon's learner; another child is multiprocessing's own."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    (child,) = (
        child for child in children if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text()
    )
    return int(child)


def _key(event: Event) -> tuple[str, float, str, str]:
    return (event.camera, event.t, event.kind, str(event.track))


MakeSite = Callable[..., Site]
"""The fixture ``make_site``; takes the arguments of `Site` after the directory."""


def check(site: Site) -> None:
    """Check that every event is stored once, and versions are those of an uninterrupted learner."""
    status = site.finish()
    assert status["learner"]["late"] == 0, "else the order of arrival would matter"
    assert site.lost_and_doubled() == (0, 0)
    expected = site.expected()
    assert status["version"] == max(expected)
    newest = max(expected)
    epochs = {epoch for epoch, _ in site.versions}
    assert len(epochs) == 1
    assert site.newest == sorted(site.newest), "versions only go up"
    for (_, version), digest in site.versions.items():
        assert expected[version] == digest
    assert (*epochs, newest) in site.versions
