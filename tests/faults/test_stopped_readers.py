"""Programs that subscribe and stop reading do not delay others.

The daemon and every stopped reader are processes of their own. The control is a reader in the
test's process: it has to receive each prediction soon after its exit.
"""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from puppets import HQ, Puppet, client
from real_daemon import OPEN, RealDaemon, status_over
from serving import WAIT_SECONDS, wait_for
from site_keys import Keys
from synthetic_topology import synthetic_topology

from camtopod import codec
from camtopod.config.settings import BusSettings, Config, SiteSettings
from camtopod.records import Event, Prediction
from camtopod.serve.bus import sockets
from camtopod.serve.bus.session import Bus, dial, open_daemon_session
from camtopod.serve.bus.topology_subscriber import TopologySubscriber
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Journal, StoredVersion

SITE = SiteSettings("hq")
SITE_CAMERAS = 150
"""Their topology has some hundred kilobytes, so that a link takes a few of them at most."""
SENDERS = [f"cam{number:04d}" for number in range(12)]
LATE_SECONDS_MAX = 0.5
CONTROL_SECONDS = 2.0
BUSY_SECONDS = 0.1
"""The machine is busy if something is late by more than this that no stopped reader delays: then
the daemon may leave out predictions, which it counts.
"""
LINGER_SECONDS = 10.0
"""What closing one connection would take."""
SMALL_BUFFER_BYTES = 4096
PAGE_SECONDS = 0.02
"""Between two looks at how busy the machine is."""


class Walks:
    """Exits at a steady rate, delivered from a spool, with the delay of each prediction."""

    def __init__(self, publisher: Publisher, reader: Bus, per_second: float, folder: Path) -> None:
        self._publisher = publisher
        self._reader = reader
        self._per_second = per_second
        self._folder = folder
        self._mutex = threading.Lock()
        self._put: dict[tuple[str, float], float] = {}
        self.delays: list[tuple[float, float]] = []
        """When each exit was put (monotonic), and seconds to its prediction."""
        self._began = time.monotonic()
        self.held_up = 0.0
        """Longest delay (seconds) that no stopped reader has caused: of this process, of a page of
        its own on the disk, or of a message before any reader stopped.
        """
        self._skipped_before = 0
        reader.subscribe("prediction/*", self._on_prediction)

    def control(self) -> None:
        """Walk without stopped readers, and take the delays as the machine's own."""

        def is_heard() -> bool:  # earlier exits do not count
            self._walk(1.01 / self._per_second)
            return bool(self.delays)

        wait_for(is_heard, "the first prediction")
        assert self._publisher.wait_stored(WAIT_SECONDS)
        with self._mutex:
            self._put.clear()
            self.delays.clear()
        self._skipped_before = self._skipped_ever()
        self.walk(CONTROL_SECONDS)
        self.await_all()
        self.held_up = max(self.held_up, *(delay for _, delay in self.delays))
        self.delays.clear()

    def await_all(self) -> None:
        """Wait until each exit is stored, and has a prediction or was left out."""
        assert self._publisher.wait_stored(WAIT_SECONDS)
        wait_for(lambda: len(self._put) <= self.skipped, "a prediction for each exit")

    def late(self) -> str:
        """Return which predictions were late, and when they were put."""
        allowed = LATE_SECONDS_MAX + self.held_up
        late = [(put - self._began, delay) for put, delay in self.delays if delay >= allowed]
        if not late:
            return ""
        worst = max(delay for _, delay in late)
        return f"{len(late)}, put {late[0][0]:.2f} to {late[-1][0]:.2f} s in, by {worst:.2f} s"

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
        """Write pages as a commit does, to measure the machine's own delays."""
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
            event = Event(camera, "exit", time.time(), 0.5, 0.5)
            event = codec.event_from_msgpack(codec.to_msgpack(event))
            with self._mutex:
                self._put[camera, event.t] = time.monotonic()
            self._publisher.publish(event)

    @property
    def skipped(self) -> int:
        """How many predictions the daemon has left out because it had no time for them."""
        return self._skipped_ever() - self._skipped_before

    def _skipped_ever(self) -> int:
        return int(status_over(self._reader)["predictions_skipped"])

    def _on_prediction(self, key: str, payload: bytes) -> None:
        now, prediction = time.monotonic(), codec.read(Prediction, payload, pack=True)
        with self._mutex:
            put = self._put.pop((prediction.camera, prediction.t), None)
            if put is not None:
                self.delays.append((put, now - put))


def learned_state(directory: Path) -> None:
    """Make a state directory whose newest version is large."""
    topology = synthetic_topology(SITE_CAMERAS)
    journal = Journal(directory)
    content = codec.to_json(topology)
    version = StoredVersion(topology.epoch, topology.version, topology.digest, content)
    journal.commit([], [version], now=time.time())
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


class Scene:
    """A daemon with a large topology, a publisher, a reader, and readers that stop."""

    def __init__(self, folder: Path, secured: bool, stack: contextlib.ExitStack) -> None:
        learned_state(folder / "daemon" / "state")
        keys = Keys(folder / "keys")
        bus = OPEN
        if secured:
            keys.authority.issue("camera", "box", 100, cameras=SENDERS)
            access = keys.allow(keys.folder / "daemon" / "access.json")
            own = keys.folder / "daemon"
            bus = (
                f'[bus]\nlisten = ["tls/127.0.0.1:0"]\n[bus.tls]\nca = "{own}/ca.pem"\n'
                f'certificate = "{own}/certificate.pem"\nprivate_key = "{own}/private.key"\n'
                f'access = "{access}"\n'
            )
        self.folder = folder / "daemon"
        daemon = RealDaemon(self.folder, f'[site]\nname = "hq"\n{bus}')
        stack.callback(daemon.stop)
        self.stopping = client(daemon.endpoint)
        settings = [BusSettings(connect=(daemon.endpoint,))] * 2
        if secured:
            settings = [keys.bus(name, daemon.endpoint) for name in ("camera/box", "reader/wall")]
            self.stopping |= keys.tls("reader/wall")
        else:
            self.stopping |= {"transport/link/tcp/so_rcvbuf": SMALL_BUFFER_BYTES}
        box, self.reader = (
            stack.enter_context(dial(Config(bus=one, site=SITE))) for one in settings
        )
        spool = Spool(folder / "spool.db", "b1", 100_000)
        stack.callback(spool.close)
        self.publisher = Publisher(spool)
        self.publisher.attach(box, SENDERS)
        stack.callback(self.publisher.close)


@pytest.fixture
def scene(quick_path: Path) -> Iterator[Callable[[bool], Scene]]:
    with contextlib.ExitStack() as stack:
        yield lambda secured: Scene(quick_path, secured, stack)


def walks_beside(
    scene: Scene, readers: int, questions: int, per_second: float, turns: int, seconds: float
) -> Walks:
    """Publish exits while readers stop, are killed and return."""
    walks = Walks(scene.publisher, scene.reader, per_second, scene.folder)
    walks.control()
    stopping = Stopping(scene.stopping)
    try:
        for _ in range(turns):
            stopping.come(readers, questions)
            walks.walk(seconds)
            if turns > 1:
                stopping.go()
        walks.await_all()
    finally:
        stopping.go()
    return walks


def test_readers_that_stop_and_come_back_hold_up_nobody(scene: Callable[[bool], Scene]) -> None:
    one = scene(True)
    walks = walks_beside(one, readers=4, questions=60, per_second=20, turns=2, seconds=3)

    assert not walks.late()
    subscriber = TopologySubscriber(one.reader)
    wait_for(lambda: subscriber.update() is not None, "the topology")


@pytest.mark.campaign
@pytest.mark.parametrize("secured", [False, True], ids=["open", "tls"])
def test_many_that_stop_hold_up_nobody_where_many_walk(
    scene: Callable[[bool], Scene], secured: bool
) -> None:
    """Nor when the bus gives them up, after its lease of ten seconds."""
    one = scene(secured)
    walks = walks_beside(one, readers=8, questions=3, per_second=400, turns=1, seconds=14)

    assert not walks.late()
    assert walks.skipped == 0 or walks.held_up > BUSY_SECONDS


def test_closing_the_connections_of_those_who_stopped_takes_no_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The bus gives them up when their lease ends, with full connections, before the
    kernel does.
    """
    monkeypatch.setattr(sockets, "STALLED_SECONDS_MAX", 60.0)
    listening = BusSettings(listen=("tcp/127.0.0.1:0",))
    with open_daemon_session(Config(bus=listening, site=SITE)) as session:
        gone, heard, came = set[str](), threading.Event(), [0.0]
        session.watch_alive("reader", lambda name, alive: None if alive else gone.add(name))
        puppets = [Puppet() for _ in range(4)]
        for number, puppet in enumerate(puppets):
            assert puppet.open(**client(session.endpoint))
            puppet.do("subscribe", key=f"{HQ}/topology/*")
            puppet.do("appear", key=f"{HQ}/alive/reader/stopped{number}")
        wait_for(lambda: len(session.list_alive("reader")) == len(puppets), "the readers")
        with dial(Config(bus=BusSettings(connect=(session.endpoint,)), site=SITE)) as healthy:
            healthy.subscribe(
                "status/a", lambda key, payload: (came.append(time.monotonic()), heard.set())
            )
            try:
                for puppet in puppets:
                    os.kill(puppet.pid, signal.SIGSTOP)
                for _ in range(40):
                    session.publish_raw("topology/x", bytes(500_000), "topology")
                longest, began = 0.0, time.monotonic()
                while len(gone) < len(puppets):
                    heard.clear()
                    put = time.monotonic()
                    session.publish_raw("status/a", b"x", "status")
                    assert heard.wait(30.0)
                    longest = max(longest, came[-1] - put)
                    assert put - began < 30.0, f"only {gone} were given up"
                    time.sleep(0.01)  # the rate of the traffic
            finally:
                end(puppets)
    assert longest < LINGER_SECONDS / 2
