"""The exchange of a shard with the other shards of its site.

A shard subscribes to the cameras it needs, publishes updates of what it has learned, and predicts
with the topology that all shards made. Shard 0 merges that topology (`site_merger`).
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from camtopod import codec
from camtopod.config import Config
from camtopod.records import Topology
from camtopod.serve.bus import ROLE, Bus, OnMessage, QueryError, TopologySubscriber
from camtopod.serve.learner_process import LearnerFeeder, ShardUpdate
from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.serve.shards.membership import ShardMembership
from camtopod.serve.shards.site_merger import SiteMerger
from camtopod.serve.shards.subscriptions import Subscriptions
from camtopod.serve.storage import Version

log = logging.getLogger(__name__)

TELL_SECONDS = 1.0
"""Interval at which a shard publishes its progress."""
_FOLLOW_SECONDS = 0.1
"""Interval of checks for a new topology of the site."""


class ShardExchange:
    """The exchange of one shard.

    use: called with each version of the whole site, first with the newest there is.
    """

    def __init__(
        self,
        config: Config,
        share: ShardMembership,
        directory: Path,
        bus: Bus,
        learning: LearnerFeeder,
        told: bytes | None,
        clock: Clock,
        use: Callable[[Version | Topology], None],
    ) -> None:
        self._bus, self._share, self._learning, self._use = bus, share, learning, use

        # Continue from the learner's last update.
        newest = (
            ShardUpdate(*share.shard, None)
            if told is None
            else codec.read(ShardUpdate, told, pack=True)
        )
        self._parts = {part.district: part for part in newest.parts}
        self._reached, self._published = newest.reached, 0
        self._mutex = threading.Lock()
        self._came = threading.Event()
        self._clock, self._config = clock, config
        self.merger: SiteMerger | None = None
        """The merger of shard 0; None in other shards."""
        if share.shard[0] == 0:
            self.merger = SiteMerger(
                directory,
                config.keep,
                config.learn,
                config.site.name,
                share.sharding,
                share.shard[1],
                clock,
                use,
            )
            if self.merger.topology is not None:
                use(self.merger.topology)

    @property
    def reason(self) -> str:
        """Why no version of the whole site is stored at the moment; "" if they are stored."""
        return "" if self.merger is None else self.merger.reason

    def serve(self, on_event: OnMessage, on_alive: Callable[[str, bool], None]) -> None:
        """Subscribe to events and updates, and answer queries of other shards."""
        self.hearing = Subscriptions(
            self._bus, self._share, self._clock, on_event, on_alive, self._config.limits.streams_max
        )
        self.hearing.add_cameras(self._config.cameras)
        self._bus.watch_alive("grabber", self.hearing.on_alive)
        self._bus.answer_queries(
            f"part/{self._share.shard[0]}", lambda key, parameters: self._answer(), "part"
        )
        if self.merger is not None:
            self._bus.subscribe("part/*", self.merger.on_update)
            self._bus.watch_alive(ROLE, lambda name, alive: self._came.set())
        else:
            self._view = TopologySubscriber(self._bus)

    def publish(self, version: Version) -> None:
        """Publish a version of this shard's districts that is stored."""
        assert version.told is not None
        told = codec.read(ShardUpdate, version.told, pack=True)
        with self._mutex:
            self._parts |= {part.district: part for part in told.parts}
            self._reached = told.reached
            self._published += 1
        self._bus.publish_raw(f"part/{self._share.shard[0]}", version.told, "part")

    def publish_progress(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Publish this shard's progress until ``stopping``, and follow the needs of its learner.

        Shard 0 also queries the other shards' updates when a shard has appeared: it may have
        published them while it was cut off, or while no shard 0 was running.
        """
        while not stopping.wait(TELL_SECONDS):
            if self.merger is not None and self._came.is_set():
                self._came.clear()
                self._query_updates(self.merger)
            self._share.strangers = self._learning.strangers
            reached = self._learning.reached

            # Progress may be published once all versions up to there are published.
            if self._learning.made == self._published:
                self._reached = reached
            self._bus.publish(
                f"part/{self._share.shard[0]}",
                ShardUpdate(*self._share.shard, self._reached),
                "part",
            )
            beat()

    def follow(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Use the site's topology as it changes until ``stopping``; shard 0 makes it."""
        if self.merger is not None:
            self.merger.work(stopping, beat)
            return
        while not stopping.wait(_FOLLOW_SECONDS):
            newest = self._view.update()
            if newest is not None:
                self._use(newest)
            beat()

    def close(self) -> None:
        """Close the merger; only after the loops have ended."""
        if self.merger is not None:
            self.merger.close()

    def _answer(self) -> ShardUpdate:
        """Return an update with the newest part of each district."""
        with self._mutex:
            return ShardUpdate(
                *self._share.shard, self._reached, [self._parts[key] for key in sorted(self._parts)]
            )

    def _query_updates(self, merger: SiteMerger) -> None:
        """Query the updates of all shards."""
        try:
            answers = self._bus.query("part/*")
        except QueryError as error:  # any program may have answered
            log.warning("querying the shards' updates failed, it is repeated: %s", error)
            self._came.set()
            return
        for key, payload in answers:
            merger.on_update(key, payload)
