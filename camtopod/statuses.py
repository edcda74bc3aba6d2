"""The newest statuses of a site, as a display receives them, for `camtopod.words`.

`without_cameras` is for those that keep matches: a status says which cameras are forgotten.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable

from camtopod import codec
from camtopod.records import DaemonStatus, Match, Status, Topology
from camtopod.topology import last_events
from camtopod.words import (
    CameraState,
    DaemonState,
    alarms_in_words,
    camera_states,
    daemon_state,
)

CAMERAS_MAX = 5_000
"""Cameras whose status is kept."""


class Statuses:
    """Collects statuses as they arrive, on any thread; each is replaced as a whole.

    clock: seconds, to notice senders that are silent.

    daemon: newest status of the daemon; an empty one until one is received.
    heard_at: when it was received; until then, when this began.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._reachable_since = clock()
        self._grabbers: dict[str, tuple[Status, float]] = {}
        """Newest status of each camera, and when it was received."""
        self.daemon = DaemonStatus()
        self.heard_at = self._reachable_since

    def on_status(self, key: str, payload: bytes) -> None:
        """Store a status published on ``status/...``; a malformed one is ignored."""
        name = key.removeprefix("status/")
        with contextlib.suppress(codec.Rejected):
            if name == "daemon":
                self.daemon = codec.read(DaemonStatus, payload, pack=True)
                self.heard_at = self._clock()
                return
            status = codec.read(Status, payload, pack=True)
            has_room = name in self._grabbers or len(self._grabbers) < CAMERAS_MAX
            if has_room and codec.is_camera(name):
                self._grabbers[name] = (status, self._clock())

    def note_unreachable(self) -> None:
        """Note that no status can arrive now, so that no camera counts as silent for that."""
        self._reachable_since = self._clock()

    def cameras(self, topology: Topology | None) -> list[CameraState]:
        """Return the state of each camera, those that need attention first."""
        now = self._clock()
        grabbers = {
            name: (status, abs(now - max(last_t, self._reachable_since)))
            for name, (status, last_t) in self._grabbers.copy().items()
        }
        event_times = last_events(topology) if topology is not None else {}
        return camera_states(self.daemon, grabbers, topology, event_times)

    def daemon_state(self, topology: Topology | None, away: str = "") -> DaemonState:
        """Return the state of the daemon; ``away``: why nothing can be heard of it."""
        quiet = abs(self._clock() - self.heard_at)
        alarms = alarms_in_words(topology)
        return daemon_state(self.daemon, quiet, self.cameras(topology), alarms, away)


def without_cameras(matches: Iterable[Match], cameras: Collection[str]) -> list[Match]:
    """Return the matches that name none of the cameras, and whose walk is through none of them."""
    matches = list(matches)
    walks = {match.walk for match in matches if match.camera in cameras}
    return [
        match
        for match in matches
        if match.walk not in walks
        and match.walk.rpartition("@")[0] not in cameras
        and all(passage.camera not in cameras for passage in match.from_)
    ]
