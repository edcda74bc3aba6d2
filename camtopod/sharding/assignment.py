"""Assign cameras to districts and districts to shards.

The joint fit couples all cameras whose events it uses, so it cannot be split between machines with
the same result. The unit of learning is therefore a *district*: the cameras that a stable rule
assigns to it, independent of the number of machines. Shard i of n runs the districts d with
d % n = i, so 1, 2 and 4 shards learn the same.

Each district receives the events of its own cameras, its neighbours and new cameras
(`district_learner`). To find paths that open later, it also receives *guests*: event time is cut
into *turns*, and in each turn, one part of all the site's cameras is received by every district. In
which turns a camera is a guest follows from its name alone, so shards need not exchange lists of
cameras.
"""

from __future__ import annotations

import hashlib
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Annotated

from msgspec import Meta, Struct

from camtopod.event_time import microseconds

REMEMBERED_MAX = 100_000
"""Largest number of cameras whose assignment is cached; names may be invented without limit."""
_Number = Annotated[int, Meta(ge=1)]


class Sharding(Struct, frozen=True, forbid_unknown_fields=True):
    """How cameras are assigned to districts (the ``[shards]`` table of the configuration).

    It must be the same in all shards of a site, and does not depend on the number of shards.
    """

    districts: _Number = 16
    """Number of districts of the site, which is also the largest possible number of shards."""
    together: tuple[str, ...] = ()
    """Patterns of camera ids, such as ``floor1-*``. Cameras with the same first matching pattern
    are in one district; the patterns are assigned to the districts in turn. Other cameras are
    assigned by a hash of their id.
    """
    guest_turns: _Number = 8
    """Number of turns in which each camera is a guest of all districts once. With 1, every district
    receives all cameras of the site at all times.
    """
    turn_hours: Annotated[float, Meta(gt=0)] = 1.0
    """Length of a turn in hours of event time: enough for dozens of objects on a path."""


class Assignment:
    """The assignment of cameras to districts, and to the turns in which they are guests.

    turn_us: length of a turn in microseconds of event time.
    """

    def __init__(self, sharding: Sharding) -> None:
        self.sharding = sharding
        self.turn_us = microseconds(sharding.turn_hours * 3600.0)
        self._district = lru_cache(REMEMBERED_MAX)(self._deal)
        self._turn = lru_cache(REMEMBERED_MAX)(self._guest_turn)

    def district(self, camera: str) -> int:
        """Return the number of the district that a camera is assigned to."""
        return self._district(camera)

    def is_guest(self, camera: str, turn: int) -> bool:
        """Return True if a camera is a guest of all districts in a turn, given by its number."""
        return turn % self.sharding.guest_turns == self._turn(camera)

    def _deal(self, camera: str) -> int:
        """Compute the district of a camera, by pattern or by hash."""
        for number, pattern in enumerate(self.sharding.together):
            if fnmatchcase(camera, pattern):
                return number % self.sharding.districts
        return stable_hash(camera, b"district") % self.sharding.districts

    def _guest_turn(self, camera: str) -> int:
        """Compute the turn, modulo ``guest_turns``, in which a camera is a guest."""
        return stable_hash(camera, b"guest") % self.sharding.guest_turns


def districts_of(shard: int, shards: int, districts: int) -> list[int]:
    """Return the numbers of the districts that one shard runs.

    shard: number of the shard, from 0.
    shards, districts: number of shards and of districts of the site.

    Raise ValueError if there is no such shard, or if there are more shards than districts.
    """
    if not 0 <= shard < shards:
        raise ValueError(f"there is no shard {shard} of {shards}: they count from 0")
    if shards > districts:
        raise ValueError(f"{shards} shards cannot share {districts} districts")
    return list(range(shard, districts, shards))


def stable_hash(text: str, purpose: bytes) -> int:
    """Return a hash of a text that is the same on every machine and in every run.

    purpose: makes hashes of the same text for different purposes independent.
    """
    return int.from_bytes(
        hashlib.blake2b(text.encode(), digest_size=8, person=purpose).digest(), "big"
    )
