"""A publisher's session on the bus of a site, opened in the background."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from camtopod.config import Config
from camtopod.serve.bus import Bus, BusError, dial, log_other_sites, sites_instead
from camtopod.serve.outbox.publisher import SpoolPublisher
from camtopod.serve.outbox.spool import OWNER

RETRY_SECONDS = 1.0
"""Interval between two attempts to connect."""


class SiteLink:
    """Joins a site as soon as possible, and has the publisher deliver there until `close`.

    A site that cannot be reached delays no other: each has a link of its own.

    cameras: cameras that deliver to ``site`` from the beginning.
    site: the site as the spool names it; `OWNER` is that of ``config``.
    """

    def __init__(
        self,
        config: Config,
        publisher: SpoolPublisher,
        cameras: Sequence[str] = (),
        site: str = OWNER,
    ) -> None:
        self.config = config.at(site or config.site.name)
        self.bus: Bus | None = None
        """The session, once there is one."""
        self.closing = threading.Event()
        """Set it to end the attempts to connect; `close` waits for the present one."""
        self._publisher = publisher
        self._cameras = cameras
        self._site = site
        self._thread = threading.Thread(target=self._join, name="link", daemon=True)
        self._thread.start()

    def close(self, wait: bool = True) -> None:
        """End the delivery and leave the bus; without ``wait`` only if there is a session."""
        self.closing.set()
        if wait:
            self._thread.join()
        if (delivery := self._publisher.at(self._site)) is not None:
            delivery.close()
        if self.bus is not None:
            self.bus.close()

    def on_miss(self, error: BusError) -> None:
        """Take note that the site cannot be reached; it is tried again."""

    def on_bus(self, bus: Bus) -> None:
        """Take note of the session."""
        log_other_sites(bus, sites_instead(bus, self.config))

    def _join(self) -> None:
        while not self.closing.is_set():
            try:
                bus = dial(self.config)
            except BusError as error:
                self.on_miss(error)
                self.closing.wait(RETRY_SECONDS)
                continue
            self._publisher.attach(bus, self._cameras, self._site)
            self.bus = bus
            if self.closing.is_set():  # `close` may not have seen the session
                bus.close()
            else:
                self.on_bus(bus)
            return
