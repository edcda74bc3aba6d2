"""A whole site of processes that can be killed: a router, the daemon, a publisher per camera."""

from __future__ import annotations

import os
import queue
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import traffic
from serving import camtopod, free_endpoint, wait_for

from camtopod import codec
from camtopod.cli import exits
from camtopod.config.settings import BusSettings, Config, parse
from camtopod.learn.learner import Learner
from camtopod.records import Event, Topology
from camtopod.serve.bus.session import Bus, dial
from camtopod.serve.storage.journal import Journal

HERE = Path(__file__).parent
OUTAGE_SECONDS_MAX = 60.0
"""Longest delay of an event by any fault, so that the order of arrival does not matter."""
READY_SECONDS = 60.0
"""Longest wait for a process to start or answer, seconds."""
SAID_LINES_MAX = 40
"""Lines of the daemon's output that are kept for failures."""
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
        self.directory, self.count, self.span, self.speed, self.spools = (
            directory,
            count,
            span,
            speed,
            spools,
        )
        self.events = traffic.crossings(count, span)
        self.router_endpoint = free_endpoint()
        self.at_daemon = self.at_publishers = self.router_endpoint
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._said: dict[str, deque[bytes]] = {"daemon": deque()}
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
            self._await(process, process.stdout, b"ready")
        elif name == "daemon":
            config = self.directory / "camtopod.toml"
            config.write_text(self.daemon_toml())
            process = camtopod("--config", str(config), "run", stderr=subprocess.PIPE)
            self._said[name] = self._await(process, process.stderr, b"ready at")
        else:
            spool = str(self.directory / f"spool-{name}.db") if self.spools else "-"
            process = self._python(
                "traffic.py",
                self.at_publishers,
                spool,
                name,
                str(self.count),
                str(self.span),
                str(self.speed),
                str(self.began),
            )
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
        process = self.processes.pop(_program(name))
        if name == LEARNER:
            os.kill(_child(process.pid), signal.SIGKILL)
            assert process.wait(READY_SECONDS) == exits.FAILED
        else:
            process.kill()
            process.wait()
        self._close_pipes(process)

    def running(self, name: str) -> bool:
        """Return True if a process has not ended by itself."""
        program = _program(name)
        return program in self.processes and self.processes[program].poll() is None

    def finish(self, seconds: float = 600.0) -> dict[str, Any]:
        """Wait until all events are stored and learned, and end the daemon.

        Returns the daemon's last status.
        """
        for camera in traffic.CAMERAS:
            wait_for(
                lambda one=camera: not self.running(one), f"publisher {camera} to end", seconds
            )  # type: ignore[misc]
            assert self.processes[camera].returncode == 0
        assert self._bus is not None
        for camera in (
            traffic.AFTER,
            f"{traffic.AFTER}2",
        ):  # event time follows the second camera
            stored = self.status()["events"]["stored"]
            self._bus.publish(f"event/{camera}", traffic.last_event(self.span, camera), "event")
            wait_for(
                lambda before=stored: self.status()["events"]["stored"] > before, "the last event"
            )  # type: ignore[misc]
        wait_for(lambda: all_learned(self.status()), "the learner", seconds)
        status = self.status()
        if newest := status["version"]:  # while the daemon can still be queried for it
            wait_for(lambda: self.has_heard(newest), "the newest version to be heard")
        self.processes["daemon"].terminate()
        assert self.processes["daemon"].wait(30) == 0
        return status

    def close(self) -> None:
        """End all processes."""
        for process in self.processes.values():
            if process.poll() is None:
                process.kill()
            process.wait()
            self._close_pipes(process)
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
        process = self.processes.pop(name)
        process.terminate()
        process.wait()
        self._close_pipes(process)
        time.sleep(seconds)
        self.start(name)

    # --- results ----------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Return the daemon's status, asking repeatedly."""
        assert self._bus is not None
        deadline = time.monotonic() + READY_SECONDS
        while time.monotonic() < deadline:
            answers = self._bus.query("status/daemon", seconds=1.0, one=True)
            if answers:
                found: dict[str, Any] = msgspec.msgpack.decode(answers[0][1])
                return found
            time.sleep(0.05)
        raise AssertionError(
            f"the daemon does not answer; it {'runs' if self.running('daemon') else 'has ended'}, "
            f"the client is {'' if self._bus.connected else 'not '}connected; "
            f"last output: {b''.join(self._said['daemon']).decode()}"
        )

    def journal(self) -> list[Event]:
        """Return all events in the journal, without boot and seq, except the closing ones."""
        journal = Journal(self.directory / "state")
        events = [
            codec.event_from_msgpack(entry.raw)
            for _, entry in journal.entries()
            if entry and entry.kind == "event"
        ]
        journal.close()
        return [
            msgspec.structs.replace(event, boot=None, seq=None)
            for event in events
            if event.camera in traffic.CAMERAS
        ]

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
            f'[state]\ndirectory = "{self.directory}/state"\n'
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

    def _await(self, process: subprocess.Popen[bytes], pipe: Any, what: bytes) -> deque[bytes]:
        """Wait until a process prints ``what``; return its last lines, which go on
        being updated.
        """
        said: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        lines: deque[bytes] = deque(maxlen=SAID_LINES_MAX)

        def read() -> None:
            with suppress(ValueError):  # closed
                for line in pipe:
                    lines.append(line)
                    said.put(line)
            said.put(b"")

        threading.Thread(target=read, daemon=True).start()
        while what not in (line := said.get(timeout=READY_SECONDS)):
            assert line, f"{process.args!r} ended: {b''.join(lines).decode()}"
        return lines

    @staticmethod
    def _close_pipes(process: subprocess.Popen[bytes]) -> None:
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()


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
"""The fixture ``make_site``; takes the arguments of `Routes` after the directory."""


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
