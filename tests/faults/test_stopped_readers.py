"""Programs that subscribe and stop reading do not delay others.

The daemon and every stopped reader are processes of their own. The control is a reader in the
test's process: it has to receive each prediction soon after its exit.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from grabber import Delays, learned_state, publisher_on
from puppets import HQ, Puppet, client
from real_daemon import OPEN, RealDaemon
from serving import WAIT_SECONDS, wait_for
from site_keys import Keys

from camtopod.config.settings import BusSettings, Config, SiteSettings
from camtopod.serve.bus import dial
from camtopod.serve.bus.topology_subscriber import TopologySubscriber

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
    """A daemon with a large topology, a publisher, and a reader that notes the predictions' delays."""

    def __init__(self, folder: Path, secured: bool, stack: contextlib.ExitStack) -> None:
        learned_state(folder / "daemon" / "state", SITE_CAMERAS)
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
        self._delays = Delays(self.reader)

    def walk(self, seconds: float) -> None:
        """Publish exits at a steady rate."""
        self._delays.walk(self._publisher, SENDERS, int(seconds * PER_SECOND), PER_SECOND)

    def longest_delay(self) -> float:
        """Return that without stopped readers, which is the machine's own."""

        def is_heard() -> bool:
            self.walk(1.01 / PER_SECOND)
            return bool(self._delays.seconds)

        wait_for(is_heard, "the first prediction")
        self.await_predictions()
        self.walk(CONTROL_SECONDS)
        return max(self.await_predictions())

    def await_predictions(self) -> list[float]:
        """Wait until each exit is stored and has a prediction; return the delays."""
        assert self._publisher.wait_stored(WAIT_SECONDS)
        return self._delays.await_all()

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
        delays = scene.await_predictions()
    finally:
        end(stopped)

    longest = max(delays)
    print(f"{len(delays)} predictions, the latest after {longest:.2f} s, usually {usual:.2f}")
    assert longest < usual + LATE_SECONDS_MAX
    subscriber = TopologySubscriber(scene.reader)
    wait_for(lambda: subscriber.update() is not None, "the topology")
