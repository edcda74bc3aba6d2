"""A version of the topology as the daemon keeps it: packed, beside the few fields it needs itself.

Unpacked, a version takes four times the memory.
"""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Raw, Struct

from camtopod import codec
from camtopod.records import Alarm, SelfScore, Topology
from camtopod.topology import joins_two_views


class Head(Struct, frozen=True):
    """The fields of a version that the daemon's status shows, and the lengths of its lists.

    links: number of links between views.
    """

    epoch: str
    version: int
    as_of: float
    digest: str
    cameras: int
    zones: int
    links: int
    alarms: list[Alarm]
    score: SelfScore | None


class _Ends(Struct, rename={"from_": "from"}):
    """The fields of a `Link` that tell links between views from those of one view."""

    from_: str
    to: str


class _Lists(Struct):
    """The fields of a `Topology` that a head is made from; items of lists stay undecoded."""

    epoch: str
    version: int
    as_of: float
    digest: str
    cameras: list[Raw]
    zones: list[Raw]
    links: list[_Ends]
    alarms: list[Alarm] | None = None
    score: SelfScore | None = None


class CurrentVersion(NamedTuple):
    """The current version: packed, or as a `Topology` if that is in memory anyway."""

    head: Head
    whole: Topology | bytes

    @property
    def topology(self) -> Topology:
        """The version, decoded at once."""
        return (
            codec.read(Topology, self.whole, pack=True)
            if isinstance(self.whole, bytes)
            else self.whole
        )

    @property
    def raw(self) -> Topology | Raw:
        """An object that encodes to the version's MessagePack."""
        return Raw(self.whole) if isinstance(self.whole, bytes) else self.whole


class Version(NamedTuple):
    """A new version on its way to the journal and then to the bus.

    content: the version as JSON.
    packed: the version as MessagePack.
    delta: the changes since the last version as MessagePack; None for the first.
    """

    head: Head
    content: bytes
    packed: bytes
    delta: bytes | None

    @classmethod
    def of(cls, topology: Topology, delta: bytes | None = None) -> Version:
        """Pack a version."""
        return cls(head_of(topology), codec.to_json(topology), codec.to_msgpack(topology), delta)

    @property
    def newest(self) -> CurrentVersion:
        """The version as it is kept once it is published."""
        return CurrentVersion(self.head, self.packed)


def head_of(topology: Topology | bytes) -> Head:
    """Return the head of a version, given as a `Topology` or as MessagePack."""
    one = codec.read(_Lists, topology, pack=True) if isinstance(topology, bytes) else topology
    return Head(
        one.epoch,
        one.version,
        one.as_of,
        one.digest,
        len(one.cameras),
        len(one.zones),
        sum(map(joins_two_views, one.links)),
        one.alarms or [],
        one.score,
    )
