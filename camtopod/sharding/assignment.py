"""Assign cameras to districts and districts to shards.

The joint fit couples all cameras that it sees, so it cannot be split between machines with the same
result. The unit of learning is therefore a *district*: the cameras that a stable rule assigns to
it, on however many machines the districts run. Shard i of n works the districts d with d % n = i,
so 1, 2 and 4 shards learn the same.

Each district receives the events of its own cameras, its neighbours and new cameras
(`district_learner`) and, so that it finds a path that opens later, of *guests*: in each turn of
event time, one part of all the site's cameras is received by every district. Who is a guest in a
turn follows from the camera's name and the time alone, so no list of cameras has to be agreed on.
"""

from __future__ import annotations

import hashlib
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Annotated

from msgspec import Meta, Struct

from camtopod.event_time import microseconds

REMEMBERED_MAX = 100_000
"""Cameras whose assignment is cached: names may be invented, so the cache is limited."""
_Number = Annotated[int, Meta(ge=1)]


class Sharding(Struct, frozen=True, forbid_unknown_fields=True):
    """How cameras are assigned to districts (the ``[shards]`` table of the configuration).

    It is the same in all shards of a site, and does not depend on their number.
    """

    districts: _Number = 16
    """Districts of the site: the largest possible number of shards."""
    together: tuple[str, ...] = ()
    """Patterns of camera ids, such as ``floor1-*``. Cameras whose first matching pattern is the
    same are in one district; the patterns are assigned to the districts in turn. Other cameras are
    assigned by a hash of their id.
    """
    guest_turns: _Number = 8
    """Each camera is a guest of all districts in one of this many turns. With 1, every district
    receives all cameras of the site at all times.
    """
    turn_hours: Annotated[float, Meta(gt=0)] = 1.0
    """Length of a turn in hours of event time: enough for dozens of objects on a path."""


class Assignment:
    """The assignment of cameras to districts, and of guests to turns."""

    def __init__(self, sharding: Sharding) -> None:
        self.sharding = sharding
        self.turn_us = microseconds(sharding.turn_hours * 3600.0)
        self._district = lru_cache(REMEMBERED_MAX)(self._deal)
        self._turn = lru_cache(REMEMBERED_MAX)(self._guest_turn)

    def district(self, camera: str) -> int:
        """Return the district that the camera is assigned to."""
        return self._district(camera)

    def is_guest(self, camera: str, turn: int) -> bool:
        """Return True if the camera is a guest of all districts in the turn."""
        return turn % self.sharding.guest_turns == self._turn(camera)

    def _deal(self, camera: str) -> int:
        for number, pattern in enumerate(self.sharding.together):
            if fnmatchcase(camera, pattern):
                return number % self.sharding.districts
        return stable_hash(camera, b"district") % self.sharding.districts

    def _guest_turn(self, camera: str) -> int:
        return stable_hash(camera, b"guest") % self.sharding.guest_turns


def districts_of(shard: int, shards: int, districts: int) -> list[int]:
    """Return the districts that one of several shards works.

    Raises ValueError if there is no such shard, or if there are more shards than districts.
    """
    if not 0 <= shard < shards:
        raise ValueError(f"there is no shard {shard} of {shards}: they count from 0")
    if shards > districts:
        raise ValueError(f"{shards} shards cannot share {districts} districts")
    return list(range(shard, districts, shards))


def stable_hash(text: str, purpose: bytes) -> int:
    """Return a hash that is the same on every machine and in every run."""
    return int.from_bytes(
        hashlib.blake2b(text.encode(), digest_size=8, person=purpose).digest(), "big"
    )
