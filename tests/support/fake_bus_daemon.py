"""A daemon in this process for the tests of what talks to one: it has learned from made-up
walkers.
"""

from __future__ import annotations

import contextlib
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

from camtopod.client import Topology, aio
from camtopod.config.settings import BusSettings, SiteSettings
from camtopod.learn.learner import Learner
from camtopod.records import Event
from camtopod.records import Topology as Version
from camtopod.serve.bus.session import Bus, dial
from camtopod.serve.daemon import Daemon

NOW = T0 + 20 * SPAN_SECONDS
LEFT: dict[str, Any] = {"camera": "a", "t": NOW, "x": 0.9, "y": 0.5}


def there(site: Topology | aio.Topology) -> None:
    """Until the daemon knows of what has been subscribed to: a question takes the same way."""
    site._bus.ask("topology")


@contextlib.contextmanager
def running(
    directory: Path, endpoint: str, bus: BusSettings | None = None, site: str = "site"
) -> Iterator[Daemon]:
    """A daemon at an endpoint, or as ``bus`` says; stopped in any case, else the tests would not
    end.
    """
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
    for event in events:
        bus.put(f"event/{event.camera}", event, "event")


def later(events: list[Event], spans: int) -> list[Event]:
    return [msgspec.structs.replace(event, t=event.t + spans * SPAN_SECONDS) for event in events]


def learned(daemon: Daemon, events: list[Event]) -> Version:
    """The daemon's version once it has learned what the plain learner learns of these events, by
    time.
    """
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


class Hub:
    """A daemon that has learned from 200 walkers, and somebody who puts events."""

    def __init__(self, daemon: Daemon, bus: Bus) -> None:
        self.daemon, self.bus = daemon, bus
        events = [*numbered(walkers(200)), closing_event()]
        put(bus, *events)
        learned(daemon, events)

    def walks(self, count: int, span: int) -> list[Event]:
        """So many people, so many spans later."""
        events = later(walkers(count, seed=span), span)
        put(self.bus, *events)
        return events


@contextlib.contextmanager
def a_hub(directory: Path) -> Iterator[Hub]:
    """A hub of its own."""
    with (
        running(directory, free_endpoint()) as daemon,
        dial(small_config(directory, daemon.endpoint)) as bus,
    ):
        yield Hub(daemon, bus)
