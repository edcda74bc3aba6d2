"""Programs that subscribe and stop reading do not delay others.

The daemon and every stopped reader are processes of their own. The control is a reader in the
test's process: it has to receive each prediction soon after its exit.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from grabber import publisher_on
from puppets import HQ, Puppet, client
from real_daemon import OPEN, RealDaemon
from serving import WAIT_SECONDS, wait_for
from site_keys import Keys
from synthetic_topology import synthetic_topology

from camtopod import codec
from camtopod.config.settings import BusSettings, Config, SiteSettings
from camtopod.records import Event, Prediction
from camtopod.serve.bus import dial
from camtopod.serve.bus.topology_subscriber import TopologySubscriber
from camtopod.serve.storage.journal import Journal, StoredVersion

SITE = SiteSettings("hq")
SITE_CAMERAS = 150
"""Their topology has some hundred kilobytes, so that a link takes a few of them at most."""
SENDERS = [f"cam{number:04d}" for number in range(12)]
LATE_SECONDS_MAX = 2.0
"""Beyond what the machine itself delays a prediction; a stopped reader would delay it by 5 s."""
CONTROL_SECONDS = 1.0
SECONDS = 14.0
PER_SECOND = 400
READERS = 8
SMALL_BUFFER_BYTES = 4096
QUESTIONS = 3
"""Of a reader for the topology before it stops; the answers fill its connection."""


class Scene:
    """A daemon with a large topology, a publisher, and a reader that notes the predictions' delays.

    delays: seconds from each exit to its prediction.
    """

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
        daemon = RealDaemon(folder / "daemon", f'[site]\nname = "hq"\n{bus}')
        stack.callback(daemon.stop)
        self._stopping = client(daemon.endpoint)
        settings = [BusSettings(connect=(daemon.endpoint,))] * 2
        if secured:
            settings = [keys.bus(name, daemon.endpoint) for name in ("camera/box", "reader/wall")]
            self._stopping |= keys.tls("reader/wall")
        else:
            self._stopping |= {"transport/link/tcp/so_rcvbuf": SMALL_BUFFER_BYTES}
        box, self.reader = (
            stack.enter_context(dial(Config(bus=one, site=SITE))) for one in settings
        )
        self._publisher = stack.enter_context(publisher_on(box, folder, SENDERS))
        self._mutex = threading.Lock()
        self._put: dict[tuple[str, float], float] = {}
        self.delays: list[float] = []
        self.reader.subscribe("prediction/*", self._on_prediction)

    def walk(self, seconds: float) -> None:
        """Publish exits at a steady rate."""
        began = time.monotonic()
        for number in range(int(seconds * PER_SECOND)):
            due = began + number / PER_SECOND
            time.sleep(max(0.0, due - time.monotonic()))  # the rate of the traffic
            event = Event(SENDERS[number % len(SENDERS)], "exit", time.time(), 0.5, 0.5)
            event = codec.event_from_msgpack(codec.to_msgpack(event))
            with self._mutex:
                self._put[event.camera, event.t] = time.monotonic()
            self._publisher.publish(event)

    def longest_delay(self) -> float:
        """Return that without stopped readers, which is the machine's own."""

        def is_heard() -> bool:
            self.walk(1.01 / PER_SECOND)
            return bool(self.delays)

        wait_for(is_heard, "the first prediction")
        self.await_predictions()
        self.delays.clear()
        self.walk(CONTROL_SECONDS)
        self.await_predictions()
        longest = max(self.delays)
        self.delays.clear()
        return longest

    def await_predictions(self) -> None:
        """Wait until each exit is stored and has a prediction."""
        assert self._publisher.wait_stored(WAIT_SECONDS)
        wait_for(lambda: not self._put, "a prediction for each exit")

    def stopped_readers(self) -> list[Puppet]:
        """Return readers that subscribe, ask for the topology, and stop reading."""
        puppets = []
        for _ in range(READERS):
            puppet = Puppet()
            assert puppet.open(**self._stopping)
            puppet.do("subscribe", key=f"{HQ}/prediction/*")
            puppet.do("ask_many", key=f"{HQ}/topology", times=QUESTIONS)
            os.kill(puppet.pid, signal.SIGSTOP)
            puppets.append(puppet)
        return puppets

    def _on_prediction(self, key: str, payload: bytes) -> None:
        now, prediction = time.monotonic(), codec.read(Prediction, payload, pack=True)
        with self._mutex:
            put = self._put.pop((prediction.camera, prediction.t), None)
            if put is not None:
                self.delays.append(now - put)


def learned_state(directory: Path) -> None:
    """Make a state directory whose newest version is large."""
    topology = synthetic_topology(SITE_CAMERAS)
    journal = Journal(directory)
    content = codec.to_json(topology)
    version = StoredVersion(topology.epoch, topology.version, topology.digest, content)
    journal.commit([], [version], now=time.time())
    journal.close()


def end(puppets: list[Puppet]) -> None:
    """End stopped processes."""
    for puppet in puppets:
        os.kill(puppet.pid, signal.SIGKILL)
        os.kill(puppet.pid, signal.SIGCONT)
        puppet.close()


@pytest.fixture
def make_scene(quick_path: Path) -> Iterator[Callable[[bool], Scene]]:
    with contextlib.ExitStack() as stack:
        yield lambda secured: Scene(quick_path, secured, stack)


@pytest.mark.campaign
@pytest.mark.parametrize("secured", [False, True], ids=["open", "tls"])
def test_readers_that_stop_hold_up_nobody(
    make_scene: Callable[[bool], Scene], secured: bool
) -> None:
    """Nor when the bus gives them up, after its lease of ten seconds."""
    scene = make_scene(secured)
    usual = scene.longest_delay()
    stopped = scene.stopped_readers()
    try:
        scene.walk(SECONDS)
        scene.await_predictions()
    finally:
        end(stopped)

    longest = max(scene.delays)
    print(f"{len(scene.delays)} predictions, the latest after {longest:.2f} s, usually {usual:.2f}")
    assert len(scene.delays) > SECONDS * PER_SECOND / 2, "most are not left out"
    assert longest < usual + LATE_SECONDS_MAX
    subscriber = TopologySubscriber(scene.reader)
    wait_for(lambda: subscriber.update() is not None, "the topology")
