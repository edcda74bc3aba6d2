"""Publish events without losing any: store them in the spool, and deliver them to the daemons."""

from __future__ import annotations

import logging
import sqlite3
import threading
from collections.abc import Sequence

from camtopod.records import Event
from camtopod.serve.bus import Bus
from camtopod.serve.outbox.site_delivery import SiteDelivery
from camtopod.serve.outbox.spool import OWNER, Spool
from camtopod.serve.runtime import Rejects

log = logging.getLogger(__name__)

PENDING_EVENTS_MAX = 10_000
"""Most events kept in memory while the spool cannot be written (disk full).

Beyond it the newest are dropped.
"""
TRANSACTION_EVENTS_MAX = 5_000
"""Most events stored in one transaction when many come at once, some hundredths of a second."""


class SpoolPublisher:
    """Publish the events of some cameras. Call `publish` and `retry` from one thread.

    spool: belongs to the caller, who closes this publisher before the buses and the spool.
    live: the events happen now: publish each for predictions. Those of a recording are only
        delivered.

    Until `attach` joins a site, its events wait in the spool. `publish` and `retry` raise
    `sqlite_file.Damaged`.
    """

    def __init__(self, spool: Spool, live: bool = True) -> None:
        self._spool = spool
        self._live = live
        self._pending: list[Event] = []
        self._unwritable = False
        self._drops = 0
        self.published = 0
        """Events stored in the spool since the start."""
        self.repeats = 0
        """Events since the start that had been stored in it before."""
        self.rejects = Rejects()
        """Answers that could not be read."""
        self._change = threading.Condition()
        self._sites: dict[str, SiteDelivery] = {}
        self._closing = False

    def attach(self, bus: Bus, cameras: Sequence[str] = (), site: str = OWNER) -> None:
        """From now on publish on ``bus``, which is that of ``site``, for these cameras.

        Those with events in the spool, and further ones with their first event, are added if they
        deliver to the site. Call it once for each site, on any thread.
        """
        delivery = SiteDelivery(self._spool.queue(site), bus, self.rejects, self._change)
        with self._change:
            if self._closing:
                return
            self._sites = {**self._sites, site: delivery}
        delivery.start(cameras)

    def publish(self, *events: Event) -> None:
        """Store events in the spool and publish them.

        A spool that cannot be written is logged once, and tried again with the next events.
        """
        self._pending.extend(events)
        try:
            self.retry()
        finally:
            self._drops += len(self._pending[PENDING_EVENTS_MAX:])
            del self._pending[PENDING_EVENTS_MAX:]

    def retry(self) -> None:
        """Store and publish the events that could not be stored yet; cheap if there are none."""
        for delivery in self._sites.values():
            if delivery.damage is not None:
                raise delivery.damage
        while self._pending:
            # Store a batch, or keep it in memory.
            events = self._pending[:TRANSACTION_EVENTS_MAX]
            try:
                batch = self._spool.append(events)
            except sqlite3.Error as error:
                if not self._unwritable:
                    self._unwritable = True
                    log.error("cannot write the spool: %s; events wait in memory", error)
                return
            if self._unwritable:
                self._unwritable = False
                log.info("the spool can be written again")
            del self._pending[:TRANSACTION_EVENTS_MAX]
            self.published += len(batch)
            self.repeats += len(events) - len(batch)

            # Have it delivered, and publish it for viewers.
            for camera in {event.camera for event in batch}:
                for delivery in self._deliveries(camera):
                    delivery.introduce(camera)
            for event in batch if self._live else ():
                for delivery in self._deliveries(event.camera):
                    delivery.publish(event)

    def wait_stored(
        self, seconds: float, limit: int = 0, own: bool = False, site: str | None = None
    ) -> bool:
        """Wait until at most ``limit`` events wait; return False if not within ``seconds``.

        own: count only those of boots of which this process was given events.
        site: count only those that wait for this site.
        """
        with self._change:
            return self._change.wait_for(lambda: self.count_waiting(own, site) <= limit, seconds)

    def count_waiting(self, own: bool = False, site: str | None = None) -> int:
        """Return the number of events that are not known to be stored by the daemons of all sites.

        own, site: as for `wait_stored`.
        """
        spool = self._spool if site is None else self._spool.queue(site)
        return spool.waiting(own=own) + len(self._pending)

    @property
    def waiting(self) -> int:
        """Number of events that are not known to be stored by the daemons of all sites."""
        return self.count_waiting()

    def at(self, site: str = OWNER) -> SiteDelivery | None:
        """Return the deliveries to a site; None before it was attached."""
        return self._sites.get(site)

    def drop(self, camera: str) -> None:
        """Delete the events that wait of a camera of one site, and count them as dropped."""
        if self._spool.sites(camera) == [OWNER]:
            self._spool.queue().drop(camera)

    @property
    def dropped(self) -> int:
        """Events lost as the spool was full or could not be written, or by `drop`."""
        return self._drops + self._spool.dropped

    def outcome(self, site: str = OWNER) -> tuple[int, int]:
        """Return how many events of this process were late, and how many refused."""
        late, refusals = self._sites[site].outcome() if site in self._sites else (0, 0)
        return late, refusals + self._spool.rejects.counts.total()

    def statistics(self, site: str = OWNER) -> dict[str, int]:
        """Return counters for the status; of the events that wait or were dropped, a site's."""
        return {
            **self._spool.statistics(),
            "published": self.published,
            "waiting": self.count_waiting(site=site),
            "dropped": self._drops + self._spool.queue(site).dropped,
            "rejected": self.rejects.counts.total(),
        }

    def close(self) -> None:
        """End the delivery; may be called twice."""
        with self._change:
            self._closing = True
        for delivery in self._sites.values():
            delivery.close()

    def _deliveries(self, camera: str) -> list[SiteDelivery]:
        """Return the deliveries of the sites that hear a camera, of those that were attached."""
        sites = self._sites
        return [sites[site] for site in self._spool.sites(camera) if site in sites]
