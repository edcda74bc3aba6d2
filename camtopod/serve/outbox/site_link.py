"""A publisher's session on the bus of a site, opened in the background."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from camtopod.config import Config
from camtopod.serve.bus import Bus, BusError, dial, log_other_sites, sites_instead
from camtopod.serve.outbox.publisher import Publisher
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
        self, config: Config, publisher: Publisher, cameras: Sequence[str] = (), site: str = OWNER
    ) -> None:
        self._config = config.at(site or config.site.name)
        self._publisher = publisher
        self._cameras = cameras
        self._site = site
        self._bus: Bus | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._join, name="link", daemon=True)
        self._thread.start()

    def request_end(self) -> None:
        """End the attempts to connect; `close` waits until the present one has ended."""
        self._closing.set()

    def close(self) -> None:
        """End the delivery and leave the bus."""
        self.request_end()
        self._thread.join()
        if self._bus is not None:
            if (delivery := self._publisher.at(self._site)) is not None:
                delivery.close()
            self._bus.close()

    def _join(self) -> None:
        while not self._closing.is_set():
            try:
                self._bus = dial(self._config)
            except BusError:  # the site is waited for
                self._closing.wait(RETRY_SECONDS)
                continue
            self._publisher.attach(self._bus, self._cameras, self._site)
            log_other_sites(self._bus, sites_instead(self._bus, self._config))
            return
