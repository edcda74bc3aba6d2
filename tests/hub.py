"""A daemon in this process for the tests of what talks to one: it has learned from made-up walkers."""

from __future__ import annotations

from pathlib import Path

import msgspec
from serving import SPAN_SECONDS, T0, closing_event, free_endpoint, numbered, small_config, wait_for, walkers

from camtopod.config import BusSettings, SiteSettings
from camtopod.learn.learner import Learner
from camtopod.records import Event, Topology
from camtopod.serve.bus import Bus, dial
from camtopod.serve.daemon import Daemon

NOW = T0 + 20 * SPAN_SECONDS


def started(directory: Path, endpoint: str, bus: BusSettings | None = None, name: str = "site") -> Daemon:
    config = small_config(directory / "state")
    config = msgspec.structs.replace(config, bus=bus or BusSettings(listen=(endpoint,)), site=SiteSettings(name))
    daemon = Daemon(config, clock=lambda: NOW)
    daemon.start()
    return daemon


def put(bus: Bus, *events: Event) -> None:
    for event in events:
        bus.put(f"event/{event.camera}", event, "event")


def later(events: list[Event], spans: int) -> list[Event]:
    return [msgspec.structs.replace(event, t=event.t + spans * SPAN_SECONDS) for event in events]


def learned(daemon: Daemon, events: list[Event]) -> Topology:
    """The daemon's version once it has learned what the plain learner learns of these events, by time."""
    learner = Learner(small_config(Path()).learn, site="site", epoch="any")
    for event in events:
        learner.receive(event)
    assert learner.topology is not None
    digest = learner.topology.digest
    wait_for(lambda: daemon.topology is not None and daemon.topology.digest == digest, "the events to be learned")
    assert daemon.topology is not None
    return daemon.topology


class Hub:
    """A daemon that has learned from 200 walkers, and somebody who puts events."""

    def __init__(self, directory: Path) -> None:
        self.endpoint = free_endpoint()
        self.daemon = started(directory, self.endpoint)
        self.bus = dial(small_config(directory, self.endpoint))
        events = [*numbered(walkers(200)), closing_event()]
        put(self.bus, *events)
        learned(self.daemon, events)

    def walks(self, count: int, span: int) -> list[Event]:
        """So many people, so many spans later."""
        events = later(walkers(count, seed=span), span)
        put(self.bus, *events)
        return events

    def close(self) -> None:
        self.bus.close()
        self.daemon.stop()
