"""The cameras that a shard owns, and those whose events it needs.

The owner of a camera follows from the camera's name alone (`camtopod.sharding.assignment`), so
every shard knows it.
"""

from __future__ import annotations

from camtopod.event_time import microseconds
from camtopod.keys import STATUS
from camtopod.serve.learner_process import ShardScope
from camtopod.serve.runtime import owns_every_camera
from camtopod.sharding import Assignment, Sharding, districts_of

SOON_SECONDS = 60.0
"""Time before its turn at which a guest is subscribed to.

Clocks differ, and subscribing takes a moment.
"""


class ShardMembership:
    """The membership of shard ``shard`` = (i, n), with i from 0 to n - 1."""

    def __init__(self, sharding: Sharding, shard: tuple[int, int]) -> None:
        self.sharding, self.shard = sharding, shard
        self.strangers: frozenset[str] = frozenset()
        """Other shards' cameras that are needed only as guests, as the learner said last."""
        self._dealing = Assignment(sharding)
        self._districts = frozenset(districts_of(*shard, sharding.districts))

    @property
    def is_first(self) -> bool:
        """True for shard 0.

        It makes the topology of the whole site and, unless there is a router, is the meeting point.
        """
        return self.shard[0] == 0

    @property
    def folder(self) -> str:
        """Folder within the state directory, as shards may share a machine."""
        return "shard-{}-of-{}".format(*self.shard)

    @property
    def portion(self) -> ShardScope:
        """The learner's part of the site."""
        return ShardScope(self.sharding, self.shard)

    @property
    def name(self) -> str:
        """Name for people, e.g. ``2/8``."""
        return "{}/{}".format(*self.shard)

    @property
    def status_key(self) -> str:
        """Key of the daemon's status."""
        return STATUS if self.is_first else f"status/shard/{self.shard[0]}"

    def owns(self, camera: str) -> bool:
        """Return True if this shard stores the camera's events and answers its exits."""
        return self._dealing.district(camera) in self._districts

    def needs(self, camera: str, now: float) -> bool:
        """Return True if the camera's events at about ``now`` (Unix seconds) are needed.

        The guests of the two turns before count too: they may be neighbours that the learner has
        not reported yet.
        """
        if self.owns(camera) or camera not in self.strangers:
            return True
        turn = microseconds(now + SOON_SECONDS) // self._dealing.turn_us
        return any(self._dealing.is_guest(camera, one) for one in (turn - 2, turn - 1, turn))


class WholeSite:
    """The membership of a daemon that serves the site alone."""

    shard = portion = None
    is_first, folder, status_key = True, "", STATUS

    def owns(self, camera: str) -> bool:
        """Return True: it owns every camera."""
        return owns_every_camera(camera)
