"""Subscribe to the events of the cameras that a shard needs.

These are all cameras but strangers, which are needed only in their turns as guests. So the traffic
of a shard grows with its own cameras, not with the site. On a small site all cameras are subscribed
to: it costs little, and then the speed at which recorded events are replayed does not matter.
"""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable, Iterable

from camtopod.records import CAMERA_PATTERN
from camtopod.serve.bus import Bus, OnMessage
from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.serve.shards.membership import ShardMembership

log = logging.getLogger(__name__)

SMALL_CAMERAS_MAX = 100
"""Most cameras on the bus for which all are subscribed to."""
_LOOK_SECONDS = 1.0
"""Interval of checks whether the subscriptions are still right."""


class Subscriptions:
    """The subscriptions of a shard.

    on_heard: called as (camera, alive) when a camera that is subscribed to appears, or is no longer
        there or subscribed to.
    """

    def __init__(
        self,
        bus: Bus,
        share: ShardMembership,
        clock: Clock,
        on_event: OnMessage,
        on_heard: Callable[[str, bool], None],
        cameras_max: int,
    ) -> None:
        self._bus, self._share, self._clock = bus, share, clock
        self._on_event, self._on_heard, self._cameras_max = on_event, on_heard, cameras_max
        self._alive: dict[str, bool] = {}  # known cameras, and whether their publisher is present
        self._changed = threading.Event()
        self._told: set[str] = set()
        self._ends: dict[str, Callable[[], None]] = {}

    @property
    def cameras(self) -> set[str]:
        """Cameras subscribed to."""
        return set(self._ends)

    def add_cameras(self, cameras: Iterable[str]) -> None:
        """Add cameras of the site, whether or not their publishers are present."""
        for camera in cameras:
            if len(self._alive) < self._cameras_max and re.match(CAMERA_PATTERN, camera):
                self._alive.setdefault(camera, False)

    def on_alive(self, camera: str, alive: bool) -> None:
        """Take note that a publisher has appeared or vanished. Called from a thread of the bus."""
        self.add_cameras([camera])
        if camera in self._alive:
            self._alive[camera] = alive
            self._changed.set()

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Keep the subscriptions up to date until ``stopping``."""
        while not stopping.is_set():
            self._changed.clear()
            self.update()
            beat()
            self._changed.wait(_LOOK_SECONDS)

    def update(self) -> None:
        """Subscribe to the cameras that are needed now, and to no others."""
        # Which cameras are needed?
        alive = self._alive.copy()
        now, few = self._clock(), len(alive) <= SMALL_CAMERAS_MAX
        wanted = {camera for camera in alive if few or self._share.needs(camera, now)}

        # Change the subscriptions.
        for camera in sorted(wanted - self._ends.keys()):
            self._ends[camera] = self._bus.subscribe(f"event/{camera}", self._on_event)
        for camera in sorted(self._ends.keys() - wanted):
            self._ends.pop(camera)()

        # Report cameras that appear or vanish.
        there = {camera for camera in wanted if alive[camera]}
        for camera in sorted(there ^ self._told):
            self._on_heard(camera, camera in there)
        self._told = there
