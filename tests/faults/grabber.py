"""Grabbers without cameras: a spool and its publisher; and what came of it in a journal."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from serving import T0, WAIT_SECONDS, free_endpoint, small_config

from camtopod.config.settings import BusSettings
from camtopod.records import Event
from camtopod.serve.bus import Bus, dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Journal

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
        self.publisher = Publisher(self.spool)
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
def publisher_on(bus: Bus, directory: Path, cameras: Sequence[str] = ()) -> Iterator[Publisher]:
    """Yield a publisher of these cameras with a spool in ``directory``."""
    with (
        contextlib.closing(Spool(directory / "spool.db", "b1", 1_000_000)) as spool,
        contextlib.closing(Publisher(spool)) as publisher,
    ):
        publisher.attach(bus, cameras)
        yield publisher


def stored(state: Path) -> list[tuple[int | None, bytes]]:
    """Return (seq, bytes) of the events in a journal, in order."""
    with contextlib.closing(Journal(state)) as journal:
        entries = [entry for _, entry in journal.entries() if entry is not None]
    return [(entry.seq, entry.raw) for entry in entries if entry.kind == "event"]
