"""Grabbers without cameras: a spool and its publisher; and what came of it in a journal."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from serving import T0, WAIT_SECONDS, free_endpoint, small_config, wait_for
from synthetic_topology import synthetic_topology

from camtopod import codec
from camtopod.config.settings import BusSettings
from camtopod.records import Event, Prediction
from camtopod.serve.bus import Bus, dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import SpoolPublisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Journal, StoredVersion

NOW = T0 + 10_000.0
"""What the daemons' clocks say, Unix seconds."""


class Grabber:
    """The camera ``lobby``, whose spool is in ``directory``; daemons may come and go at one place.

    made: number of its events, which are numbered from 1.
    """

    def __init__(self, directory: Path, state: Path | None = None) -> None:
        self.made = 0
        config = small_config(state or directory / "state")
        endpoint = free_endpoint()
        self._daemon_config = msgspec.structs.replace(config, bus=BusSettings(listen=(endpoint,)))
        self.spool = Spool(directory / "spool.db", "boot-1", 100_000)
        self.publisher = SpoolPublisher(self.spool)
        self._closing = contextlib.ExitStack()
        self._closing.callback(self.spool.close)
        self._dialled = small_config(directory, endpoint)

    def daemon(self) -> Daemon:
        """Return a daemon; `attach` joins it, and those after it."""
        return Daemon(self._daemon_config, clock=lambda: NOW)

    def attach(self) -> None:
        """Join the bus of the daemon that runs now."""
        bus = self._closing.enter_context(dial(self._dialled))
        self._closing.callback(self.publisher.close)
        self.publisher.attach(bus, ["lobby"])

    def publish(self, count: int) -> None:
        """Make so many events and publish them."""
        numbers = range(self.made, self.made + count)
        self.made += count
        self.publisher.publish(*(Event("lobby", "entry", T0 + 0.1 * n) for n in numbers))

    def await_stored(self) -> None:
        """Wait until the daemon has said that all events are stored."""
        assert self.publisher.wait_stored(WAIT_SECONDS), f"{self.publisher.waiting} events wait"

    @property
    def acknowledged(self) -> int:
        """Number of events that the daemon has said it has."""
        return self.made - self.publisher.waiting

    def close(self) -> None:
        self._closing.close()


@contextlib.contextmanager
def publisher_on(
    bus: Bus, directory: Path, cameras: Sequence[str] = ()
) -> Iterator[SpoolPublisher]:
    """Yield a publisher of these cameras with a spool in ``directory``."""
    with (
        contextlib.closing(Spool(directory / "spool.db", "b1", 1_000_000)) as spool,
        contextlib.closing(SpoolPublisher(spool)) as publisher,
    ):
        publisher.attach(bus, cameras)
        yield publisher


def stored(state: Path) -> list[tuple[int | None, bytes]]:
    """Return (seq, bytes) of the events in a journal, in order."""
    with contextlib.closing(Journal(state)) as journal:
        entries = [entry for _, entry in journal.entries() if entry is not None]
    return [(entry.seq, entry.raw) for entry in entries if entry.kind == "event"]


def learned_state(directory: Path, cameras: int) -> None:
    """Make a state directory whose newest version is that of so many cameras (``cam0000`` ...)."""
    topology = synthetic_topology(cameras)
    version = StoredVersion(
        topology.epoch, topology.version, topology.digest, codec.to_json(topology)
    )
    with contextlib.closing(Journal(directory)) as journal:
        journal.commit([], [version], now=time.time())


class Delays:
    """From each exit that is published to its prediction, as a reader on ``bus`` gets it.

    seconds: the delays, in the order of the predictions.
    """

    def __init__(self, bus: Bus) -> None:
        self._mutex = threading.Lock()
        self._put: dict[tuple[str, float], float] = {}
        self.seconds: list[float] = []
        bus.subscribe("prediction/*", self._on_prediction)

    def walk(
        self, publisher: SpoolPublisher, cameras: Sequence[str], count: int, rate: float
    ) -> None:
        """Publish so many exits, ``rate`` a second, of the cameras in turn."""
        began = time.monotonic()
        for number in range(count):
            due = began + number / rate
            time.sleep(max(0.0, due - time.monotonic()))  # the rate of the traffic
            event = Event(cameras[number % len(cameras)], "exit", time.time(), 0.5, 0.5)
            event = codec.event_from_msgpack(codec.to_msgpack(event))
            with self._mutex:
                self._put[event.camera, event.t] = time.monotonic()
            publisher.publish(event)

    def await_all(self) -> list[float]:
        """Wait until each exit has its prediction; return the delays since the last call."""
        wait_for(lambda: not self._put, "a prediction for each exit")
        with self._mutex:
            seconds, self.seconds = self.seconds, []
        return seconds

    def _on_prediction(self, key: str, payload: bytes) -> None:
        now, prediction = time.monotonic(), codec.read(Prediction, payload, pack=True)
        with self._mutex:
            put = self._put.pop((prediction.camera, prediction.t), None)
            if put is not None:
                self.seconds.append(now - put)
