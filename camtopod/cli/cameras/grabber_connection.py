"""A grabber on the bus of a site: its events are delivered there, and its status is published."""

from __future__ import annotations

import argparse
import logging
import threading
from typing import Any

from camtopod import redact
from camtopod.cli.cameras.camera_process import camera_status, site_status
from camtopod.cli.site_choice import right_site
from camtopod.config import Config
from camtopod.serve.bus import Bus, BusError, access
from camtopod.serve.outbox import SiteLink, SpoolPublisher
from camtopod.vision.grabber import Grabber

log = logging.getLogger(__name__)

_DAEMON_LOOK_SECONDS = 2.0
"""Interval at which it looks for the daemon."""


class GrabberConnection(SiteLink):
    """Connection of the grabber to the bus of a site, which is made in the background.

    Until then events wait in the spool. It logs when the daemon is not there, and when it is again.
    """

    def __init__(
        self,
        config: Config,
        grabber: Grabber,
        publisher: SpoolPublisher,
        args: argparse.Namespace,
        site: str,
    ) -> None:
        self._grabber = grabber
        self._args = args
        self._mutex = threading.Lock()
        self._daemons: set[str] = set()
        self._is_missed = False
        """Whether the log says that no daemon is there."""
        super().__init__(config, publisher, [grabber.camera], site)

    def on_miss(self, error: BusError) -> None:
        """Log that the bus cannot be reached."""
        self._miss(str(error))

    def on_bus(self, bus: Bus) -> None:
        """Publish from now on."""
        bus.answer_queries(f"status/{self._grabber.camera}", lambda *_: self.status(), "status")
        bus.watch_alive("daemon", self._on_daemon)

        # Look for the daemon once; from then on the bus tells when it appears or goes.
        if not self.closing.wait(_DAEMON_LOOK_SECONDS) and not self._daemons:
            self._miss(
                f"connected to the bus at {bus.endpoint}, but no daemon of site {bus.site} is there"
                f"{right_site(bus, self.config)}"
            )

    def _on_daemon(self, name: str, alive: bool) -> None:
        """Note that a daemon has appeared or gone."""
        if not alive:
            self._daemons.discard(name)
            self._miss(f"the daemon has gone{access.ended_certificate(self.config)}")
            return
        with self._mutex:
            self._daemons.add(name)
            if self._is_missed:
                self._is_missed = False
                log.info("camera %s: connected to the daemon again", self._grabber.camera)

    def _miss(self, reason: str) -> None:
        """Log once that no daemon is there, unless one is."""
        with self._mutex:
            if not (self._daemons or self._is_missed or self.closing.is_set()):
                self._is_missed = True
                log.warning(
                    "camera %s: %s; events are kept in the spool", self._grabber.camera, reason
                )

    def status(self) -> dict[str, Any]:
        """Return the content of ``status/{camera}``."""
        grabber = self._grabber
        past = (self._args.restarts, self._args.last_end)
        return {
            **camera_status(grabber.camera, grabber.state, redact.redact(grabber.reason), *past),
            **site_status(self.config, grabber.camera),
            **grabber.statistics(),
            **self._publisher.statistics(self._site),
        }

    def publish_status(self, is_last: bool = False) -> None:
        """Publish the status if there is a connection; the last one waits for room on the link."""
        if (delivery := self._publisher.at(self._site)) is not None:  # it may deliver all at once
            droppable = False if is_last else None
            key = f"status/{self._grabber.camera}"
            delivery.bus.publish(key, self.status(), "status", droppable)
