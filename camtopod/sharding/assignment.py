"""How a site that is too large for one learner is dealt out.

The joint fit couples whatever it sees, so it cannot be split between machines and come out the
same. What is learned at one piece is therefore a *district*: the cameras that a stable rule puts
into it, the same ones on however many machines the districts run. Shard i of n works the districts
d with d % n = i, so that 1, 2 and 4 shards learn the same.

Each district hears its own cameras, its neighbours and new cameras (`district`), and, so that it
finds a way that opens later, *guests*: in each turn of event time one part of all the site's
cameras is heard by every district. Who is a guest when follows from the camera's name and the time
alone; no list of cameras has to be agreed on.
"""

from __future__ import annotations

import hashlib
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Annotated

from msgspec import Meta, Struct

from camtopod.event_time import microseconds

REMEMBERED_MAX = 100_000
"""Cameras of which it is remembered where they belong: names can be made up."""
_Number = Annotated[int, Meta(ge=1)]


class Sharding(Struct, frozen=True, forbid_unknown_fields=True):
    """How a site is dealt out: the same in all its shards, and whatever their number."""

    districts: _Number = 16
    """So many shards at most."""
    together: tuple[str, ...] = ()
    """Patterns of camera ids (``floor1-*``): the cameras that fit one, and no earlier one, are in
    one district. The patterns are dealt to the districts in turn. Other cameras are dealt by a hash
    of their id.
    """
    guest_turns: _Number = 8
    """Each camera is a guest of all districts in one turn of so many; 1: always, so every district
    hears the site.
    """
    turn_hours: Annotated[float, Meta(gt=0)] = 1.0
    """Event time: long enough to see some dozens of objects on a way between two cameras."""


class Dealing:
    """Which camera belongs where, and who is a guest when."""

    def __init__(self, sharding: Sharding) -> None:
        self.sharding = sharding
        self.turn_us = microseconds(sharding.turn_hours * 3600.0)
        self._district = lru_cache(REMEMBERED_MAX)(self._deal)
        self._turn = lru_cache(REMEMBERED_MAX)(self._guest_turn)

    def district(self, camera: str) -> int:
        """The district that the camera belongs to."""
        return self._district(camera)

    def guest(self, camera: str, turn: int) -> bool:
        """Whether every district hears the camera in a turn."""
        return turn % self.sharding.guest_turns == self._turn(camera)

    def _deal(self, camera: str) -> int:
        for number, pattern in enumerate(self.sharding.together):
            if fnmatchcase(camera, pattern):
                return number % self.sharding.districts
        return stable_hash(camera, b"district") % self.sharding.districts

    def _guest_turn(self, camera: str) -> int:
        return stable_hash(camera, b"guest") % self.sharding.guest_turns


def districts_of(shard: int, shards: int, districts: int) -> list[int]:
    """The districts that one of several shards works. Raises ValueError when there is no such
    shard, or nothing for it to do.
    """
    if not 0 <= shard < shards:
        raise ValueError(f"there is no shard {shard} of {shards}: they count from 0")
    if shards > districts:
        raise ValueError(f"{shards} shards cannot share {districts} districts")
    return list(range(shard, districts, shards))


def stable_hash(text: str, purpose: bytes) -> int:
    """The same number on every machine and in every run."""
    return int.from_bytes(
        hashlib.blake2b(text.encode(), digest_size=8, person=purpose).digest(), "big"
    )
