"""Programs that subscribe and stop reading do not delay others.

The daemon and every stopped reader are processes of their own. The control is a reader in the
test's process: it has to receive each prediction soon after its exit.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from serving import WAIT_SECONDS, wait_for
from synthetic_topology import synthetic_topology
from test_intruders import HQ, Keys, Puppet, RealDaemon, client, tls_table

from camtopod import codec
from camtopod.config.settings import BusSettings, Config, SiteSettings
from camtopod.records import Ack, Event, Prediction
from camtopod.serve.bus import sockets
from camtopod.serve.bus.session import Bus, dial, open_daemon_session
from camtopod.serve.bus.topology_subscriber import TopologySubscriber
from camtopod.serve.storage.journal import Journal, StoredVersion

SITE_CAMERAS = 150
"""Their topology has some hundred kilobytes, so that a link takes a few of them at most."""
SENDERS = [f"cam{number:04d}" for number in range(12)]
LATE_SECONDS_MAX = 0.5
CONTROL_SECONDS = 3.0
BUSY_SECONDS = 0.1
"""The machine is busy if something is late by more than this that no stopped reader delays: then
the daemon may leave out predictions, which it counts.
"""
LINGER_SECONDS = 10.0
"""What closing one connection would take."""
SMALL_BUFFER_BYTES = 4096
QUESTIONS = 60
PAGE_SECONDS = 0.02
"""Between two looks at how busy the machine is."""


class Walks:
    """Exits at a steady rate, with the delay of each prediction and acknowledgement."""

    def __init__(self, publisher: Bus, reader: Bus, per_second: float, folder: Path) -> None:
        self._publisher, self._reader = publisher, reader
        self._per_second, self._folder = per_second, folder
        self._mutex = threading.Lock()
        self._put: dict[tuple[str, float], float] = {}
        self._unacknowledged: dict[tuple[str, int], float] = {}
        self.delays: list[tuple[float, float]] = []
        """When each exit was put (monotonic), and seconds to its prediction ..."""
        self.ack_delays: list[tuple[float, float]] = []
        """... and to its ack."""
        self._began = time.monotonic()
        self.held_up = 0.0
        """Longest delay (seconds) that no stopped reader has caused: of this process, of a page of
        its own on the disk, or of a message before any reader stopped.
        """
        self._seqs = dict.fromkeys(SENDERS, 0)
        self._skipped_before = 0
        reader.subscribe("prediction/*", self._on_prediction)
        for camera in SENDERS:
            publisher.subscribe(f"ack/{camera}", self._on_ack)

    def be_heard(self) -> None:
        """Wait until the bus knows the reader's subscription; earlier exits do not count."""

        def heard() -> bool:
            self._walk(1.01 / self._per_second)
            return bool(self.delays)

        wait_for(heard, "the first prediction")
        with self._mutex:
            for noted in (self._put, self._unacknowledged, self.delays, self.ack_delays):
                noted.clear()
        self._skipped_before = self._skipped_ever()

    def end_control(self) -> None:
        """Take the delays so far, without stopped readers, as the machine's own."""
        with self._mutex:
            delays = [delay for _, delay in (*self.delays, *self.ack_delays)]
            self.held_up = max(self.held_up, *delays)
            self.delays.clear()
            self.ack_delays.clear()

    def late(self) -> str:
        """Return late messages, and how many seconds after the first exit they were."""
        allowed, said = LATE_SECONDS_MAX + self.held_up, []
        for what, delays in ("predictions", self.delays), ("acks", self.ack_delays):
            late = [(put - self._began, delay) for put, delay in delays if delay >= allowed]
            if late:
                first, last, most = late[0][0], late[-1][0], max(delay for _, delay in late)
                said.append(
                    f"{len(late)} {what}, put {first:.2f} to {last:.2f} s in, late by {most:.2f} s"
                )
        return "; ".join(said)

    def walk(self, seconds: float) -> None:
        done = threading.Event()
        writer = threading.Thread(target=self._write_pages, args=(done,))
        writer.start()
        try:
            self._walk(seconds)
        finally:
            done.set()
            writer.join()

    def _write_pages(self, done: threading.Event) -> None:
        """Write pages as a commit does, without bus and readers, to measure the
        machine's own delays.
        """
        with tempfile.TemporaryFile(dir=self._folder) as page:
            while not done.is_set():
                due = time.monotonic() + PAGE_SECONDS
                time.sleep(PAGE_SECONDS)
                page.write(b"page" * 1024)
                page.flush()
                os.fsync(page.fileno())
                self.held_up = max(self.held_up, time.monotonic() - due)

    def _walk(self, seconds: float) -> None:
        began = time.monotonic()
        for number in range(int(seconds * self._per_second)):
            due = began + number / self._per_second
            time.sleep(max(0.0, due - time.monotonic()))  # the rate of the traffic
            self.held_up = max(self.held_up, time.monotonic() - due)
            camera = SENDERS[number % len(SENDERS)]
            self._seqs[camera] += 1
            event = Event(camera, "exit", time.time(), 0.5, 0.5, boot="b", seq=self._seqs[camera])
            event = codec.event_from_msgpack(codec.to_msgpack(event))
            with self._mutex:
                now = time.monotonic()
                self._put[camera, event.t] = self._unacknowledged[camera, self._seqs[camera]] = now
            self._publisher.publish(f"event/{camera}", event, "event")

    @property
    def missing(self) -> int:
        """Return how many acks are missing, and how many predictions that were not left out."""
        return len(self._unacknowledged) + max(len(self._put) - self.skipped, 0)

    @property
    def skipped(self) -> int:
        """Return how many predictions the daemon has left out because it had no time for them."""
        return self._skipped_ever() - self._skipped_before

    def _skipped_ever(self) -> int:
        [(_, status)] = self._reader.query("status/daemon", {"format": "application/json"})
        skipped: int = json.loads(status)["predictions_skipped"]
        return skipped

    def _on_prediction(self, key: str, payload: bytes) -> None:
        now, prediction = time.monotonic(), codec.read(Prediction, payload, pack=True)
        with self._mutex:
            put = self._put.pop((prediction.camera, prediction.t), None)
            if put is not None:
                self.delays.append((put, now - put))

    def _on_ack(self, key: str, payload: bytes) -> None:
        now, ack = time.monotonic(), codec.read(Ack, payload, pack=True)
        with self._mutex:
            for camera, seq in [
                one for one in self._unacknowledged if one[0] == ack.camera and one[1] <= ack.seq
            ]:
                put = self._unacknowledged.pop((camera, seq))
                self.ack_delays.append((put, now - put))


def learned_state(directory: Path) -> None:
    """Return a state directory whose newest version is large."""
    topology = synthetic_topology(SITE_CAMERAS)
    journal = Journal(directory)
    content = codec.to_json(topology)
    journal.commit(
        [],
        [StoredVersion(topology.epoch, topology.version, topology.digest, content)],
        now=time.time(),
    )
    journal.close()


class Stopping:
    """Readers that subscribe to predictions, ask for the topology, stop reading, and may return."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self._settings = settings
        self._puppets: list[Puppet] = []

    def come(self, count: int, questions: int) -> None:
        for _ in range(count):
            puppet = Puppet()
            assert puppet.open(**self._settings)
            puppet.do("subscribe", key=f"{HQ}/prediction/*")
            puppet.do("ask_many", key=f"{HQ}/topology", times=questions)
            os.kill(puppet.pid, signal.SIGSTOP)
            self._puppets.append(puppet)

    def go(self) -> None:
        end(self._puppets)
        self._puppets.clear()


def end(puppets: list[Puppet]) -> None:
    """End stopped processes."""
    for puppet in puppets:
        os.kill(puppet.pid, signal.SIGKILL)
        os.kill(puppet.pid, signal.SIGCONT)
        with contextlib.suppress(BrokenPipeError):
            puppet.close()


Scene = Callable[[bool], tuple[Bus, Bus, dict[str, Any], Path]]


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    """Return a function that runs a daemon with a large topology, with TLS or without.

    It returns sessions of a publisher and a reader, the settings of stopped readers, and the
    daemon's folder.
    """
    with contextlib.ExitStack() as stack:

        def make(secured: bool) -> tuple[Bus, Bus, dict[str, Any], Path]:
            folder = tmp_path / "daemon"
            learned_state(tmp_path / "daemon" / "state")
            if not secured:
                daemon = RealDaemon(folder, '[bus]\nlisten = ["tcp/127.0.0.1:0"]\n')
                stack.callback(daemon.stop)
                buses = [BusSettings(connect=(daemon.endpoint,))] * 2
                stopping = client(daemon.endpoint) | {
                    "transport/link/tcp/so_rcvbuf": SMALL_BUFFER_BYTES
                }
            else:
                keys = Keys(tmp_path / "keys")
                keys.authority.issue("camera", "box", 100, cameras=SENDERS)
                keys.allow(keys.folder / "daemon" / "access.json")
                daemon = RealDaemon(folder, tls_table(keys, keys.folder / "daemon" / "access.json"))
                stack.callback(daemon.stop)
                buses = [keys.bus(name, daemon.endpoint) for name in ("camera/box", "reader/wall")]
                stopping = client(daemon.endpoint) | keys.tls("reader/wall")
            publisher, reader = (
                stack.enter_context(dial(Config(bus=bus, site=SiteSettings("hq")))) for bus in buses
            )
            return publisher, reader, stopping, folder

        yield make


def walks_beside(
    scene: Scene,
    secured: bool,
    readers: int,
    questions: int,
    per_second: float,
    turns: int,
    seconds: float,
) -> tuple[Walks, Bus]:
    """Publish exits while readers stop, are killed and return."""
    publisher, reader, settings, folder = scene(secured)
    walks = Walks(publisher, reader, per_second, folder)
    walks.be_heard()
    walks.walk(CONTROL_SECONDS)
    wait_for(lambda: walks.missing == 0, "the first predictions and acks")
    walks.end_control()
    stopping = Stopping(settings)
    try:
        for _ in range(turns):
            stopping.come(readers, questions)
            walks.walk(seconds)
            if turns > 1:
                stopping.go()
        wait_for(lambda: walks.missing == 0, "a prediction and an ack for each exit")
    finally:
        stopping.go()
    return walks, reader


def test_readers_that_stop_and_come_back_hold_up_nobody(scene: Scene) -> None:
    walks, reader = walks_beside(
        scene, True, readers=4, questions=QUESTIONS, per_second=5, turns=2, seconds=4
    )
    assert not walks.late()
    assert TopologySubscriber(reader).wait_for(1, WAIT_SECONDS) is not None


def test_many_that_stop_hold_up_nobody_where_many_walk(scene: Scene) -> None:
    """Nor when the bus gives them up, after its lease of ten seconds."""
    walks, _ = walks_beside(
        scene, False, readers=8, questions=3, per_second=400, turns=1, seconds=14
    )
    assert not walks.late()
    assert walks.skipped == 0 or walks.held_up > BUSY_SECONDS


def test_closing_the_connections_of_those_who_stopped_takes_no_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The bus gives them up when their lease ends, with full connections, before the
    kernel does.
    """
    monkeypatch.setattr(sockets, "STALLED_SECONDS_MAX", 60.0)
    site = SiteSettings("hq")
    with open_daemon_session(
        Config(bus=BusSettings(listen=("tcp/127.0.0.1:0",)), site=site)
    ) as hub:
        gone, heard, came = set[str](), threading.Event(), [0.0]
        hub.watch_alive("reader", lambda name, alive: None if alive else gone.add(name))
        puppets = [Puppet() for _ in range(4)]
        for number, puppet in enumerate(puppets):
            assert puppet.open(**client(hub.endpoint))
            puppet.do("subscribe", key=f"{HQ}/topology/*")
            puppet.do("appear", key=f"{HQ}/alive/reader/stopped{number}")
        wait_for(lambda: len(hub.list_alive("reader")) == len(puppets), "the readers")
        with dial(Config(bus=BusSettings(connect=(hub.endpoint,)), site=site)) as healthy:
            healthy.subscribe(
                "ack/a", lambda key, payload: (came.append(time.monotonic()), heard.set())
            )
            try:
                for puppet in puppets:
                    os.kill(puppet.pid, signal.SIGSTOP)
                for _ in range(40):
                    hub.publish_raw("topology/x", bytes(500_000), "topology")
                longest, began = 0.0, time.monotonic()
                while len(gone) < len(puppets):
                    heard.clear()
                    put = time.monotonic()
                    hub.publish_raw("ack/a", b"x", "ack")
                    assert heard.wait(30.0)
                    longest = max(longest, came[-1] - put)
                    assert put - began < 30.0, f"only {gone} were given up"
                    time.sleep(0.01)  # the rate of the traffic
            finally:
                end(puppets)
    assert longest < LINGER_SECONDS / 2
