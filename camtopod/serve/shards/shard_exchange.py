"""What a daemon does besides when it is one shard of several: it hears whom it has use for, tells
the others what it has learned, and predicts with the topology that all of them made. Shard 0 puts
that together (`merger`).
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from camtopod import codec
from camtopod.config import Config
from camtopod.records import Topology
from camtopod.serve.bus import ROLE, Bus, OnMessage, QueryError, TopologyView
from camtopod.serve.learner_process import Learning, Told
from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.serve.shards.membership import Share
from camtopod.serve.shards.site_merger import Merger
from camtopod.serve.shards.subscriptions import Hearing
from camtopod.serve.storage import Version

log = logging.getLogger(__name__)

TELL_SECONDS = 1.0
"""How often a shard says how far it has come."""
_FOLLOW_SECONDS = 0.1


class Sharing:
    """``use``: called with each version of the whole site, first with the newest there is."""

    def __init__(
        self,
        config: Config,
        share: Share,
        directory: Path,
        bus: Bus,
        learning: Learning,
        told: bytes | None,
        clock: Clock,
        use: Callable[[Version | Topology], None],
    ) -> None:
        self._bus, self._share, self._learning, self._use = bus, share, learning, use
        newest = Told(*share.shard, None) if told is None else codec.read(Told, told, pack=True)
        self._parts = {part.district: part for part in newest.parts}
        self._reached, self._published = newest.reached, 0
        self._mutex = threading.Lock()
        self._came = threading.Event()
        self._clock, self._config = clock, config
        self.merger: Merger | None = None
        """Of shard 0."""
        if share.shard[0] == 0:
            self.merger = Merger(
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
        """Why no version of the whole site is stored at the moment; "" if all is well."""
        return "" if self.merger is None else self.merger.reason

    def serve(self, on_event: OnMessage, on_alive: Callable[[str, bool], None]) -> None:
        """Join the others."""
        self.hearing = Hearing(
            self._bus, self._share, self._clock, on_event, on_alive, self._config.limits.streams_max
        )
        self.hearing.know(self._config.cameras)
        self._bus.watch_alive("grabber", self.hearing.on_alive)
        self._bus.answer(
            f"part/{self._share.shard[0]}", lambda key, parameters: self._answer(), "part"
        )
        if self.merger is not None:
            self._bus.subscribe("part/*", self.merger.on_part)
            self._bus.watch_alive(ROLE, lambda name, alive: self._came.set())
        else:
            self._view = TopologyView(self._bus)

    def publish(self, version: Version) -> None:
        """A version of the own districts, which is stored."""
        assert version.told is not None
        told = codec.read_in_parts(Told, version.told)
        with self._mutex:
            self._parts |= {part.district: part for part in told.parts}
            self._reached = told.reached
            self._published += 1
        self._bus.put_raw(f"part/{self._share.shard[0]}", version.told, "part")

    def tell(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Say how far this shard has come until ``stopping``; and hear who is of use. Shard 0 asks
        what the others know when one has appeared: it may have said it while it was cut off, or
        while nobody put it together.
        """
        while not stopping.wait(TELL_SECONDS):
            if self.merger is not None and self._came.is_set():
                self._came.clear()
                self._ask(self.merger)
            self._share.strangers = self._learning.strangers
            reached = self._learning.reached
            if (
                self._learning.made == self._published
            ):  # else not everything up to there has been told
                self._reached = reached
            self._bus.put(
                f"part/{self._share.shard[0]}", Told(*self._share.shard, self._reached), "part"
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
        """Only after the loops have ended."""
        if self.merger is not None:
            self.merger.close()

    def _answer(self) -> Told:
        with self._mutex:
            return Told(
                *self._share.shard, self._reached, [self._parts[key] for key in sorted(self._parts)]
            )

    def _ask(self, merger: Merger) -> None:
        try:
            answers = self._bus.ask("part/*")
        except QueryError as error:  # anybody may have answered
            log.warning("what the shards know is asked again: %s", error)
            self._came.set()
            return
        for key, payload in answers:
            merger.on_part(key, payload)
