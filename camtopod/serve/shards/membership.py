"""One shard's share of a site: which cameras are its own, which others it hears, and what it tells
the other shards.

Which camera is whose follows from its name alone (`dealing`), so every shard knows it of every
camera.
"""

from __future__ import annotations

from camtopod.event_time import microseconds
from camtopod.keys import STATUS
from camtopod.serve.learner_process import Portion
from camtopod.serve.runtime import everything
from camtopod.sharding import Dealing, Sharding, districts_of

SOON_SECONDS = 60.0
"""So long before its turn a guest is heard, as clocks differ and subscribing takes a moment."""


class Share:
    """``shard``: (i, n), i of 0 .. n - 1."""

    def __init__(self, sharding: Sharding, shard: tuple[int, int]) -> None:
        self.sharding, self.shard = sharding, shard
        self.strangers: frozenset[str] = frozenset()
        """Other shards' cameras that are of use as guests only, as the learner said last."""
        self._dealing = Dealing(sharding)
        self._districts = frozenset(districts_of(*shard, sharding.districts))

    @property
    def first(self) -> bool:
        """Shard 0, which makes the topology of the whole site and, unless there is a router, is the
        meeting point.
        """
        return self.shard[0] == 0

    @property
    def folder(self) -> str:
        """Of the state directory, as shards may share a machine."""
        return "shard-{}-of-{}".format(*self.shard)

    @property
    def portion(self) -> Portion:
        """What the learner is told."""
        return Portion(self.sharding, self.shard)

    @property
    def name(self) -> str:
        """For people: ``2/8``."""
        return "{}/{}".format(*self.shard)

    @property
    def status_key(self) -> str:
        """Where its daemon says how it is."""
        return STATUS if self.first else f"status/shard/{self.shard[0]}"

    def owns(self, camera: str) -> bool:
        """Whether this shard stores the camera's events for the site, and answers its exits."""
        return self._dealing.district(camera) in self._districts

    def hears(self, camera: str, now: float) -> bool:
        """Whether the camera's events at about ``now`` (seconds) are of use. The guests of the turn
        before are, too: they may be neighbours, and the learner not have said so yet.
        """
        if self.owns(camera) or camera not in self.strangers:
            return True
        turn = microseconds(now + SOON_SECONDS) // self._dealing.turn_us
        return any(self._dealing.guest(camera, one) for one in (turn - 2, turn - 1, turn))


class Whole:
    """The share of a daemon that has the site to itself."""

    shard = portion = None
    first, folder, status_key = True, "", STATUS

    def owns(self, camera: str) -> bool:
        """Every camera is its own."""
        return everything(camera)
