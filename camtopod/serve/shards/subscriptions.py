"""Which cameras' events a shard subscribes to: all but strangers', which it hears as guests in
their turns.

So what comes over the bus grows with the shard's own cameras, not with the site. On a small site
everything is heard: it costs little, and then it does not matter how fast recorded events are
replayed.
"""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable, Iterable

from camtopod.records import CAMERA_PATTERN
from camtopod.serve.bus import Bus, OnMessage
from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.serve.shards.membership import Share

log = logging.getLogger(__name__)

SMALL_CAMERAS_MAX = 100
"""With so few cameras on the bus all are heard."""
_LOOK_SECONDS = 1.0


class Hearing:
    """``on_heard(camera, alive)``: called as a camera that is heard appears, or is not heard any
    more.
    """

    def __init__(
        self,
        bus: Bus,
        share: Share,
        clock: Clock,
        on_event: OnMessage,
        on_heard: Callable[[str, bool], None],
        cameras_max: int,
    ) -> None:
        self._bus, self._share, self._clock = bus, share, clock
        self._on_event, self._on_heard, self._cameras_max = on_event, on_heard, cameras_max
        self._alive: dict[str, bool] = {}  # every camera known, and whether its publisher is there
        self._changed = threading.Event()
        self._told: set[str] = set()
        self._ends: dict[str, Callable[[], None]] = {}

    @property
    def heard(self) -> set[str]:
        """Cameras subscribed to."""
        return set(self._ends)

    def know(self, cameras: Iterable[str]) -> None:
        """There are these cameras, whether or not their publishers are seen."""
        for camera in cameras:
            if len(self._alive) < self._cameras_max and re.match(CAMERA_PATTERN, camera):
                self._alive.setdefault(camera, False)

    def on_alive(self, camera: str, alive: bool) -> None:
        """A publisher appeared or vanished; from a thread of the bus."""
        self.know([camera])
        if camera in self._alive:
            self._alive[camera] = alive
            self._changed.set()

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Look until ``stopping`` who is to be heard."""
        while not stopping.is_set():
            self._changed.clear()
            self.look()
            beat()
            self._changed.wait(_LOOK_SECONDS)

    def look(self) -> None:
        """Subscribe to whoever is of use now, and to nobody else."""
        alive = self._alive.copy()
        now, few = self._clock(), len(alive) <= SMALL_CAMERAS_MAX
        wanted = {camera for camera in alive if few or self._share.hears(camera, now)}
        for camera in sorted(wanted - self._ends.keys()):
            self._ends[camera] = self._bus.subscribe(f"event/{camera}", self._on_event)
        for camera in sorted(self._ends.keys() - wanted):
            self._ends.pop(camera)()
        there = {camera for camera in wanted if alive[camera]}
        for camera in sorted(there ^ self._told):
            self._on_heard(camera, camera in there)
        self._told = there
