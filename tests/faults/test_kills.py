"""kill -9 of the real daemon, its learner, publishers and the router, and links that fail.

Afterwards every event is stored once, and the versions are those of an uninterrupted learner.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from grabber import stored
from real_daemon import READY_SECONDS, RealDaemon, script, status_over
from serving import AT_ONCE, T0, free_endpoint, wait_for, walkers
from sizes import size

from bench.support.rtsp_streams import FaultProxy
from bench.support.site import children
from camtopod import codec
from camtopod.cli import exits
from camtopod.config.config_file import parse
from camtopod.config.settings import BusSettings, Config
from camtopod.learn.learner import Learner
from camtopod.records import Event, Topology
from camtopod.serve.bus import Bus, dial

CAMERAS = ("a", "b", "c")
LEARNER = "learner"
"""The daemon's learner process can be killed alone; the daemon then ends and is started again."""
EVERYBODY = (("router",), ("daemon",), (LEARNER,), CAMERAS)
EVENTS_PER_SECOND = 200
OUTAGE_SECONDS_MAX = 60.0
"""Longest delay of an event by any fault, so that the order of arrival does not matter."""


class Site:
    """A router, a daemon, and a publisher for each camera, as processes.

    They play ``count`` walkers in ``span`` seconds of event time, ``speed`` times faster.
    spools: without, the publishers publish each event once and forget it.
    constants: other ones in the daemon; see `serving.program`.
    """

    def __init__(
        self,
        directory: Path,
        count: int,
        span: float,
        speed: float,
        spools: bool = True,
        constants: Mapping[str, object] = MappingProxyType({}),
    ) -> None:
        self.directory = directory
        self.events = walkers(count, seconds=span)
        self.closing = [Event(camera, "entry", T0 + 100 * span) for camera in ("y", "z")]
        self.versions: dict[tuple[str, int], str] = {}
        self.newest: list[tuple[str, int]] = []
        self._router_endpoint = free_endpoint()
        port = int(self._router_endpoint.rpartition(":")[2])
        self._constants = constants
        self.links = {"publishers": FaultProxy(port), "daemon": FaultProxy(port)}
        self._folder = directory / "spools" if spools else "-"
        self._walk = (count, span, speed)
        self._began = 0.0
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._daemon: RealDaemon | None = None
        self._bus: Bus | None = None
        self._toml = (
            f'[bus]\nconnect = ["{self._at("daemon")}"]\nconnect_seconds = 30.0\n'
            f"[learn]\nlateness_seconds = {OUTAGE_SECONDS_MAX * speed}\nrefit_share = 0.5\n"
            "[limits]\nstatus_seconds = 0.5\n"
        )

    @property
    def bus(self) -> Bus:
        assert self._bus is not None
        return self._bus

    @property
    def status(self) -> dict[str, Any]:
        return status_over(self.bus)

    def start_all(self) -> None:
        """Start all processes, and a subscriber to the versions."""
        self.start("router")
        self.start("daemon")
        self._bus = dial(Config(bus=BusSettings(connect=(self._router_endpoint,))))
        self._bus.subscribe("topology", lambda key, raw: self.newest.append(self._note(raw)))
        self._began = time.time()
        for camera in CAMERAS:
            self.start(camera)

    def start(self, name: str) -> None:
        """Start the router, the daemon (also for its learner), or the publisher of a camera."""
        if name == "router":
            process = script("traffic.py", "router", self._router_endpoint)
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
        elif name in CAMERAS:
            given = (self._at("publishers"), self._folder, name, *self._walk, self._began)
            process = script("traffic.py", "publish", *given)
        else:
            name = "daemon"
            self._daemon = RealDaemon(self.directory, self._toml, constants=self._constants)
            process = self._daemon.process
        self._processes[name] = process

    def end(self, name: str, how: signal.Signals = signal.SIGKILL) -> None:
        """End a process."""
        process = self._processes.pop("daemon" if name == LEARNER else name)
        if name == LEARNER:
            os.kill(_learner_of(process.pid), how)
            assert process.wait(READY_SECONDS) == exits.FAILED
        process.send_signal(how)
        process.wait(READY_SECONDS)
        if name in ("daemon", LEARNER):
            assert self._daemon is not None
            self._daemon.close()
        elif process.stdout is not None:
            process.stdout.close()

    def is_running(self, name: str) -> bool:
        """Return True if a process has not ended by itself."""
        process = self._processes["daemon" if name == LEARNER else name]
        return process.poll() is None

    def await_flow(self) -> None:
        """Wait until more events are stored, or all publishers have ended."""
        before = self.status["events"]["stored"]

        def flows() -> bool:
            more = self.status["events"]["stored"] > before
            return more or not any(map(self.is_running, CAMERAS))

        wait_for(flows, "events to get through", READY_SECONDS)

    def finish(self) -> dict[str, Any]:
        """Wait until all is stored and learned, and end the daemon; return its last status."""
        for camera in CAMERAS:
            assert self._processes[camera].wait(600.0) == 0
        for event in self.closing:  # event time follows the second camera
            count = self.status["events"]["stored"]
            self.bus.publish(f"event/{event.camera}", event, "event")
            wait_for(lambda n=count: self.status["events"]["stored"] > n, "the last event")  # type: ignore[misc]
        wait_for(self._has_learned_all, "the learner", 600.0)
        status = self.status
        if status["version"]:  # while the daemon can still be asked for it
            wait_for(lambda: self._has_heard(status["version"]), "the newest version to be heard")
        process = self._processes["daemon"]
        self.end("daemon", signal.SIGTERM)
        assert process.returncode == 0
        return status

    def lost_and_doubled(self) -> tuple[int, int]:
        """Return the numbers of lost and of duplicated events in the journal."""
        entries = [codec.event_from_msgpack(raw) for _, raw in stored(self.directory / "state")]
        found = Counter(_key(event) for event in entries if event.camera in CAMERAS)
        made = Counter(map(_key, self.events))
        return (made - found).total(), (found - made).total()

    def expected(self) -> dict[int, str]:
        """Return version -> digest of an uninterrupted learner over the same events."""
        learner = Learner(parse(self._toml).learner, "site", "any")
        digests = {}
        for event in [*self.events, *self.closing]:
            learner.receive(event)
            digests |= {version.version: version.digest for version in learner.updates()}
        return digests

    def close(self) -> None:
        """End everything."""
        for name in list(self._processes):
            self.end(name)
        for link in self.links.values():
            link.close()
        if self._bus is not None:
            self._bus.close()

    def _at(self, side: str) -> str:
        """Return the router's endpoint behind the link of the publishers, or of the daemon."""
        return f"tcp/127.0.0.1:{self.links[side].port}"

    def _has_learned_all(self) -> bool:
        """Return True if the learner is at the end of the stored events, and its versions are out.

        The journal also has entries that tell which cameras the learner waits for.
        """
        file = (self.directory / "state" / "journal.db").as_uri()
        with contextlib.closing(sqlite3.connect(f"{file}?mode=ro", uri=True)) as base:
            [(count,)] = base.execute("SELECT count(*) FROM entry WHERE kind = 'event'")
        status = self.status
        learner = status["learner"]
        at_end = learner["accepted"] + learner["late"] == count and learner["held"] <= 2
        return bool(at_end and status["version"] == learner["version"])

    def _has_heard(self, newest: int) -> bool:
        """Return True if a version was received; if not, ask for the newest one.

        One that is published while the subscriber's connection is made anew is not received.
        """
        if all(version != newest for _, version in self.versions):
            for _, payload in self.bus.query("topology"):
                self._note(payload)
        return any(version == newest for _, version in self.versions)

    def _note(self, payload: bytes) -> tuple[str, int]:
        """Note the digest of a version, which never has two; return its epoch and number."""
        topology = codec.read(Topology, payload, pack=True)
        version = (topology.epoch, topology.version)
        assert self.versions.setdefault(version, topology.digest) == topology.digest
        return version


def _learner_of(pid: int) -> int:
    """Return the id of a daemon's learner; another child is multiprocessing's own."""
    [learner] = (
        child
        for child in children(pid)
        if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text()
    )
    return learner


def _key(event: Event) -> tuple[str, float, str, str]:
    return (event.camera, event.t, event.kind, str(event.track))


def kill_and_restart(site: Site, kills: int, seed: int, groups: Sequence[Sequence[str]]) -> None:
    """Kill and restart processes of random groups at random moments, with events in between."""
    chance = random.Random(seed)
    killed: Counter[str] = Counter()
    while killed.total() < kills:
        alive = [name for name in chance.choice(groups) if site.is_running(name)]
        if not alive:
            continue
        name = chance.choice(alive)
        time.sleep(chance.uniform(0.0, 0.7))
        site.end(name)
        killed[name] += 1
        time.sleep(chance.choice((0.0, chance.uniform(0.0, 1.0))))
        site.start(name)
        site.await_flow()
        print(f"{killed.total()} {name}")
    print(killed)


def silent(link: FaultProxy, seconds: float, cut: bool = False) -> None:
    """Stop all traffic unnoticed; then resume, or close all connections."""
    link.stall()
    time.sleep(seconds)
    if cut:
        link.cut()
    link.resume()


def restarted(site: Site, name: str, seconds: float) -> None:
    """End a process cleanly, and start it again after ``seconds``."""
    site.end(name, signal.SIGTERM)
    time.sleep(seconds)
    site.start(name)


def check(site: Site) -> None:
    """Check that every event is stored once, and versions are those of an uninterrupted learner."""
    status = site.finish()
    assert status["learner"]["late"] == 0, "else the order of arrival would matter"
    assert site.lost_and_doubled() == (0, 0)
    expected = site.expected()
    newest = max(expected)
    assert status["version"] == newest
    assert site.newest == sorted(site.newest), "versions only go up"
    [epoch] = {epoch for epoch, _ in site.versions}
    assert (epoch, newest) in site.versions
    for (_, version), digest in site.versions.items():
        assert expected[version] == digest


def test_silent_links_and_kills(tmp_path: Path) -> None:
    with contextlib.closing(Site(tmp_path, 200, 2 * 3600.0, 1200.0, constants=AT_ONCE)) as site:
        site.start_all()
        site.await_flow()

        for link in site.links.values():
            silent(link, 0.7, cut=True)
        for program in ("router", "daemon", LEARNER):
            kill_and_restart(site, 1, 1, ((program,),))

        check(site)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_many_kills(tmp_path: Path) -> None:
    kills, speed = size("KILLS", 30), 1000.0
    with contextlib.closing(Site(tmp_path, 40 * 8 * kills, 8 * kills * speed, speed)) as site:
        began = time.monotonic()
        site.start_all()

        kill_and_restart(site, kills, size("SEED", 1), EVERYBODY)

        check(site)
        print(f"{len(site.events)} events, {time.monotonic() - began:.0f} s")


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_links_router_and_daemon_fail_in_turn(tmp_path: Path) -> None:
    seconds, speed = size("SILENT_SECONDS", 15), 2000.0
    lasts = 3.5 * seconds + 110.0
    with contextlib.closing(
        Site(tmp_path, int(EVENTS_PER_SECOND * lasts / 4), lasts * speed, speed)
    ) as site:
        began = time.monotonic()
        site.start_all()
        steps = (
            ("links of the publishers silent", lambda: silent(site.links["publishers"], seconds)),
            ("link of the daemon silent", lambda: silent(site.links["daemon"], seconds)),
            ("router restarted", lambda: restarted(site, "router", 3.0)),
            ("daemon restarted", lambda: restarted(site, "daemon", 3.0)),
            ("all connections cut", lambda: [link.cut() for link in site.links.values()]),
        )

        for what, fault in steps:
            time.sleep(3.0)
            site.await_flow()
            fault()
            print(f"{time.monotonic() - began:.0f} s: {what}; {site.status['events']}")

        assert all(map(site.is_running, CAMERAS)), "events flowed all the time"
        check(site)
        print(f"{len(site.events)} events, {EVENTS_PER_SECOND}/s, {time.monotonic() - began:.0f} s")


@pytest.mark.campaign
def test_the_harness_sees_a_loss(tmp_path: Path) -> None:
    """The canary: publishers without spools lose messages in flight when the daemon dies."""
    with contextlib.closing(Site(tmp_path, 400, 1800.0, 600.0, spools=False)) as site:
        site.start_all()

        kill_and_restart(site, 1, 1, (("daemon",),))

        site.finish()
        lost, doubled = site.lost_and_doubled()
        assert lost > 0
        assert doubled == 0
