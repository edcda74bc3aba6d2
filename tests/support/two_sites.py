"""Daemons of two sites with a camera at their border, which both hear; each has learned."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType

from fake_bus_daemon import NOW, running
from msgspec.structs import replace
from serving import (
    all_out,
    closing_event,
    free_endpoint,
    numbered,
    small_config,
    wait_for,
    walkers,
)

from camtopod.config import BusSettings, Config, SiteSettings
from camtopod.records import Event
from camtopod.serve.bus import dial
from camtopod.serve.city_bus import CityBus
from camtopod.serve.daemon import Daemon

NAMES = MappingProxyType(
    {
        "north": {"a": "gate", "b": "hall", "c": "border", "late": "tower"},
        "south": {"a": "border", "b": "yard", "c": "ramp", "late": "shed"},
    }
)
"""By site, what the cameras of `walkers` are called there; walkers begin at ``a``."""
OWNERS = MappingProxyType(
    {
        camera: "north" if camera in ("gate", "hall", "tower") else "south"
        for cameras in NAMES.values()
        for camera in cameras.values()
    }
)
"""The border is south's."""


class TwoSites:
    """The daemons of the sites.

    on_one_bus: north's daemon is the meeting point of both; else each site has its own.
    endpoints: of the meeting points, by site.
    """

    def __init__(self, directory: Path, on_one_bus: bool = False) -> None:
        self.directory = directory
        self.endpoints = {site: free_endpoint() for site in NAMES}
        if on_one_bus:
            self.endpoints["south"] = self.endpoints["north"]
        self.daemons: dict[str, Daemon] = {}

    @contextlib.contextmanager
    def running(self, *sites: str) -> Iterator[None]:
        """Run the daemons of sites, and wait until each has learned."""
        with contextlib.ExitStack() as stack:
            for site in sites:
                folder = self.directory / site
                endpoint = self.endpoints[site]
                is_guest = site == "south" and endpoint == self.endpoints["north"]
                bus = BusSettings(connect=(endpoint,)) if is_guest else None
                self.daemons[site] = stack.enter_context(running(folder, endpoint, bus, site))
                self.put(site, *self.events(site))
            for site in sites:
                wait_for(
                    lambda site=site: all_out(self.daemons[site], len(self.events(site))),  # type: ignore[misc]
                    f"the events of {site} to be learned",
                )
            try:
                yield
            finally:
                for site in sites:
                    del self.daemons[site]

    def events(self, site: str) -> list[Event]:
        """Return the events of a site's cameras."""
        seed = len(site) + ord(site[0])
        events = [*walkers(60, seed), closing_event()]
        return numbered([replace(event, camera=NAMES[site][event.camera]) for event in events])

    def config(self, site: str) -> Config:
        """Return the configuration of a client of a site, which gives up soon."""
        config = small_config(self.directory, self.endpoints[site])
        bus = replace(config.bus, connect_seconds=0.5)
        return replace(config, bus=bus, site=SiteSettings(site))

    def put(self, site: str, *events: Event) -> None:
        """Publish events to a site."""
        with dial(self.config(site)) as bus:
            for event in events:
                bus.publish(f"event/{event.camera}", event, "event")

    def leave(self, camera: str, boot: str, *sites: str) -> None:
        """Have an object leave a camera's view now, as these sites hear."""
        for site in sites:
            self.put(site, Event(camera, "exit", NOW, 0.9, 0.5, "x", boot, 1))

    def joined(self) -> CityBus:
        """Open sessions with both sites."""
        return CityBus({site: self.config(site) for site in NAMES}, OWNERS)
