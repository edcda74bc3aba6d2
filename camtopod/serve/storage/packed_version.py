"""A version of the topology as the daemon has it: packed, and what it says of it. Read, it is four
times as large.
"""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Raw, Struct

from camtopod import codec
from camtopod.cooperative import Pause, no_pause
from camtopod.records import Alarm, SelfScore, Topology

_NOT_FOR_PREDICTION = ("links", "weak_links", "pairs", "chain", "alarms")
"""Where there is a posterior; else links are."""


class Head(Struct, frozen=True):
    """What of a version is said in the daemon's status, and how many there are of what it lists."""

    epoch: str
    version: int
    as_of: float
    digest: str
    cameras: int
    zones: int
    links: int
    alarms: list[Alarm]
    score: SelfScore | None


class _Lists(Struct):
    """The fields of a `Topology` that a head needs; lists unread."""

    epoch: str
    version: int
    as_of: float
    digest: str
    cameras: list[Raw]
    zones: list[Raw]
    links: list[Raw]
    alarms: list[Alarm] | None = None
    score: SelfScore | None = None


class Newest(NamedTuple):
    """The version that holds: packed, unless somebody else has it as such anyway."""

    head: Head
    whole: Topology | bytes

    @property
    def topology(self) -> Topology:
        """Read, in one go."""
        return (
            codec.read(Topology, self.whole, pack=True)
            if isinstance(self.whole, bytes)
            else self.whole
        )

    @property
    def raw(self) -> Topology | Raw:
        """What comes out as it is as MessagePack."""
        return Raw(self.whole) if isinstance(self.whole, bytes) else self.whole


class Version(NamedTuple):
    """A new version on its way into the journal and then onto the bus: itself, as JSON and as
    MessagePack; what has changed, as MessagePack, unless it is the first; and of a shard what the
    others are told.
    """

    head: Head
    content: bytes
    packed: bytes
    delta: bytes | None
    told: bytes | None = None

    @classmethod
    def of(cls, topology: Topology, delta: bytes | None = None) -> Version:
        """Of one that is not packed yet."""
        return cls(head_of(topology), codec.to_json(topology), codec.to_pack(topology), delta)

    @property
    def newest(self) -> Newest:
        """As it is held when it is published."""
        return Newest(self.head, self.packed)


def head_of(topology: Topology | bytes) -> Head:
    """Of a version, as such or as MessagePack."""
    one = codec.read(_Lists, topology, pack=True) if isinstance(topology, bytes) else topology
    return Head(
        one.epoch,
        one.version,
        one.as_of,
        one.digest,
        len(one.cameras),
        len(one.zones),
        len(one.links),
        one.alarms or [],
        one.score,
    )


def for_prediction(packed: bytes, pause: Pause = no_pause) -> Topology:
    """What predictions need of a version."""
    topology: Topology = codec.read_in_parts(Topology, packed, pause, left_out=_NOT_FOR_PREDICTION)
    if topology.model is None or topology.model.onward is None:
        topology = codec.read_in_parts(Topology, packed, pause)
    return topology
