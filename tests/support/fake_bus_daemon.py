"""A daemon in the test's process that has learned from simulated walkers."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from serving import (
    SPAN_SECONDS,
    T0,
    closing_event,
    free_endpoint,
    numbered,
    small_config,
    wait_for,
    walkers,
)

from camtopod.client import Site, aio
from camtopod.config.settings import BusSettings, SiteSettings
from camtopod.learn.learner import Learner
from camtopod.records import Event, Topology
from camtopod.serve.bus import Bus, dial
from camtopod.serve.daemon import Daemon

NOW = T0 + 20 * SPAN_SECONDS
"""The daemon's wall clock, which stands still."""
LEFT: dict[str, Any] = {"camera": "a", "t": NOW, "x": 0.9, "y": 0.5}
"""An exit from camera a at that time."""


def there(site: Site | aio.Site) -> None:
    """Wait until the daemon has processed earlier subscriptions: a query takes the same route."""
    site._bus.query("topology")


@contextlib.contextmanager
def running(
    directory: Path, endpoint: str, bus: BusSettings | None = None, site: str = "site"
) -> Iterator[Daemon]:
    """Run a daemon at an endpoint, or with the settings ``bus``, while the block runs."""
    config = small_config(directory / "state")
    config = msgspec.structs.replace(
        config, bus=bus or BusSettings(listen=(endpoint,)), site=SiteSettings(site)
    )
    daemon = Daemon(config, clock=lambda: NOW)
    daemon.start()
    try:
        yield daemon
    finally:
        daemon.stop()


def put(bus: Bus, *events: Event) -> None:
    """Publish events."""
    for event in events:
        bus.publish(f"event/{event.camera}", event, "event")


def later(events: list[Event], spans: int) -> list[Event]:
    """Return the events, moved ``spans`` spans later."""
    return [msgspec.structs.replace(event, t=event.t + spans * SPAN_SECONDS) for event in events]


def learned(daemon: Daemon, events: list[Event]) -> Topology:
    """Wait until the daemon has learned these events like a plain learner; return its version."""
    learner = Learner(small_config(Path()).learn, site="site", epoch="any")
    for event in events:
        learner.receive(event)
    assert learner.topology is not None
    digest = learner.topology.digest
    wait_for(
        lambda: daemon.topology is not None and daemon.topology.digest == digest,
        "the events to be learned",
    )
    assert daemon.topology is not None
    return daemon.topology


class LearnedDaemon:
    """A daemon that has learned from 200 walkers, and a client that publishes events."""

    def __init__(self, daemon: Daemon, bus: Bus) -> None:
        self.daemon, self.bus = daemon, bus
        self._walked: Counter[int] = Counter()
        events = [*numbered(walkers(200)), closing_event()]
        put(bus, *events)
        learned(daemon, events)

    def walks(self, count: int, span: int) -> list[Event]:
        """Publish ``count`` walkers, ``span`` spans later, and return their events.

        Each time they come in other seconds: a thousand events of one second are a flood.
        """
        seconds = 10.0 * (self._walked[span] % 100)
        self._walked[span] += 1
        events = [
            msgspec.structs.replace(event, t=event.t + seconds)
            for event in later(walkers(count, seed=span), span)
        ]
        put(self.bus, *events)
        return events


@contextlib.contextmanager
def running_learned_daemon(directory: Path) -> Iterator[LearnedDaemon]:
    """Run a daemon of its own that has learned."""
    with (
        running(directory, free_endpoint()) as daemon,
        dial(small_config(directory, daemon.endpoint)) as bus,
    ):
        yield LearnedDaemon(daemon, bus)
