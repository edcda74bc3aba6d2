"""One shard of a site: the districts it works, with the methods of a `Learner`.

What a district learns does not depend on which others are in the same shard, so the parts of all
shards merge into the same topology, however many shards there are.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Set

import msgspec
from msgspec import Struct

from camtopod.event_time import MICROSECONDS, EventTimeState
from camtopod.learn import (
    BYTES_MAX,
    LearnerState,
    NewerSnapshot,
    Settings,
    SnapshotError,
    pack,
    unpack,
)
from camtopod.records import Event, Topology
from camtopod.sharding.assignment import Assignment, Sharding, districts_of
from camtopod.sharding.district_learner import District, DistrictState, Membership
from camtopod.sharding.parts import Part
from camtopod.sharding.version_line import VersionLine, VersionLineState

FORMAT = 1
"""Format of a shard's snapshot; a higher number is refused."""
VERDICTS = ("accepted", "duplicate", "late", "refused", "unheard")
"""Verdicts of `ShardLearner.receive`; an ``unheard`` event is of no use to any district."""


class ShardState(Struct):
    """Complete state of a `ShardLearner`."""

    sharding: Sharding
    shard: tuple[int, int]
    """Number of the shard, from 0, and number of shards."""
    districts: list[DistrictState]
    line: VersionLineState
    counts: dict[str, int]


class ShardLearner:
    """Learner of shard ``shard`` = (i, n) of a site, i from 0 to n - 1.

    Its versions are those of its own districts alone. The versions of the site are made by a
    `VersionLine` from the parts of all shards.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        sharding: Sharding | None = None,
        shard: tuple[int, int] = (0, 1),
        site: str = "default",
        epoch: str = "0",
    ) -> None:
        self.settings, self.sharding, self.shard = (
            settings or Settings(),
            sharding or Sharding(),
            shard,
        )
        dealing = Assignment(self.sharding)
        self.districts = [
            District(self.settings, site, epoch, dealing, number)
            for number in districts_of(*shard, self.sharding.districts)
        ]
        self.counts = dict.fromkeys(VERDICTS, 0)
        self._line = VersionLine(self.settings, site, epoch)
        self._parts: list[Part] = []
        # States of the districts for which `_strangers` was determined.
        self._phases: list[tuple[int | None, int, bool]] = []
        self._strangers: frozenset[str] = frozenset()

    @property
    def topology(self) -> Topology | None:
        """The newest version."""
        return self._line.topology

    @property
    def epoch(self) -> str:
        """Epoch of the versions."""
        return self._line.epoch

    def listens(self, camera: str, t: float) -> bool:
        """Return True if an event of the camera at ``t`` (seconds) is of use to any district."""
        return any(district.listens(camera, t) for district in self.districts)

    def owns(self, camera: str) -> bool:
        """Return True if the camera is assigned to one of this shard's districts."""
        return any(district.owns(camera) for district in self.districts)

    def receive(self, event: Event) -> str:
        """Take one event and return the verdict.

        It is the verdict of the camera's own district; if that is in another shard, of the first
        district here that takes the event; else ``unheard``.
        """
        verdict = "unheard"
        for district in self.districts:
            said = district.receive(event)
            if district.owns(event.camera) or verdict == "unheard":
                verdict = said
        self.counts[verdict] += 1
        self._merge()
        return verdict

    def advance(self, now: float) -> None:
        """Move event time forward to ``now`` (seconds) without an event."""
        for district in self.districts:
            district.advance(now)
        self._merge()

    def flush(self) -> None:
        """End a recording: learn the held events and make a last version."""
        for district in self.districts:
            district.flush()
        self._merge()
        self._line.flush()

    def updates(self) -> list[Topology]:
        """Return the versions made since the last call, oldest first."""
        return self._line.updates()

    def parts(self) -> list[Part]:
        """Return the parts made since the last call, for the site's `VersionLine`.

        Call it before `reached`.
        """
        made, self._parts = self._parts, []
        return made

    def newest_parts(self) -> list[Part]:
        """Return the newest part of each of its districts."""
        return self._line.parts()

    @property
    def strangers(self) -> frozenset[str]:
        """Cameras that are of use as guests only, to all districts with own cameras."""
        owners = [district for district in self.districts if district.hearing.owner]
        phases = [district.phase for district in owners]
        if phases != self._phases:
            each = [district.strangers() for district in owners]
            self._phases, self._strangers = phases, frozenset(set.intersection(*each))
        return self._strangers

    def reached(self) -> float | None:
        """Return the event time (seconds) up to which all parts are made; None before any event.

        Districts without own cameras make no parts, so they are not waited for.
        """
        owners = [district for district in self.districts if district.hearing.owner]
        if not owners:
            heard = [
                mark for district in self.districts if (mark := district.watermark_us) is not None
            ]
            return max(heard) / MICROSECONDS if heard else None

        marks = [mark for district in owners if (mark := district.watermark_us) is not None]
        if not marks:
            return None
        held = [done for district in owners if (done := district.held_since_us) is not None]
        return min([max(marks), *held]) / MICROSECONDS

    def save(self) -> ShardState:
        """Return the state that `load` needs, without updates and parts not yet fetched."""
        districts = [district.save_all() for district in self.districts]
        return ShardState(
            self.sharding, self.shard, districts, self._line.save(), dict(self.counts)
        )

    def load(self, state: ShardState) -> None:
        """Continue from a saved state; this learner must be new.

        Raises ValueError if the state is of another shard or of other ``[shards]`` settings.
        """
        if (state.sharding, state.shard) != (self.sharding, self.shard):
            raise ValueError(f"the state is of shard {state.shard} of {state.sharding}")
        for district, saved in zip(self.districts, state.districts, strict=True):
            district.load_all(saved)
        self._line.load(state.line)
        self.counts = dict(state.counts)

    def change(self, change: Callable[[LearnerState], LearnerState]) -> None:
        """Continue with a changed state in each district, as `District.change`."""
        for district in self.districts:
            district.change(change)

    def forget(self, names: Set[str]) -> None:
        """Forget cameras, as `Learner.forget`."""
        for district in self.districts:
            district.forget(names)

    def begin_epoch(self, epoch: str) -> None:
        """Begin a new epoch: versions count from 1 again, what is known stays."""
        self._line.begin_epoch(epoch)

    def refresh(self) -> None:
        """Make the first version of the epoch from what is known, if anything is."""
        self._line.refresh()

    def next_deadline(self) -> float | None:
        """Return the event time (seconds) that `advance` must reach for anything to be learned.

        None if no events are held.
        """
        waiting = [
            due for district in self.districts if (due := district.next_deadline()) is not None
        ]
        return min(waiting, default=None)

    def event_time(self) -> EventTimeState:
        """Return the event time of the district with the highest watermark."""
        return max(
            (one.event_time() for one in self.districts), key=lambda state: state.watermark_us or 0
        )

    def statistics(self) -> dict[str, int | float]:
        """Return counts and sizes, for display and health checks.

        Cameras are own ones; windows are those of all districts together.
        """
        each = [district.statistics() for district in self.districts]
        return {
            **self.counts,
            **{name: sum(one[name] for one in each) for name in ("surplus", "held", "window")},
            "learned": sum(district.hearing.learned for district in self.districts),
            "cameras": sum(district.cameras_own for district in self.districts),
            "neighbours": sum(len(district.hearing.neighbours) for district in self.districts),
            "watermark": max((one["watermark"] for one in each), default=0.0),
            "version": 0 if self.topology is None else self.topology.version,
        }

    def _merge(self) -> None:
        """Add new parts to the version line, and make the versions that are due."""
        made = [part for district in self.districts for part in district.parts()]
        self._parts += made
        self._line.take(made)
        if self._line.waiting:
            reached = self.reached()
            if reached is not None:
                self._line.reach(reached)


class _Snapshot(Struct):
    format: int
    sharding: Sharding
    shard: tuple[int, int]
    districts: list[tuple[bytes, Membership]]
    line: VersionLineState
    counts: dict[str, int]


def pack_shard(state: ShardState) -> bytes:
    """Return the state as compressed bytes."""
    districts = [(pack(district.learner), district.hearing) for district in state.districts]
    plain = _Snapshot(FORMAT, state.sharding, state.shard, districts, state.line, state.counts)
    return zlib.compress(msgspec.msgpack.encode(plain), 1)


def unpack_shard(blob: bytes) -> ShardState:
    """Return the state from bytes.

    Raises `SnapshotError` if they are damaged, and `NewerSnapshot` if a newer program wrote them.
    """
    try:
        inflater = zlib.decompressobj()
        plain = inflater.decompress(blob, BYTES_MAX)
        if not inflater.eof:
            raise SnapshotError("the snapshot is cut short or too large")
        known = msgspec.msgpack.decode(plain, type=_Snapshot)
    except (zlib.error, msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise error if isinstance(error, SnapshotError) else SnapshotError(str(error)) from None
    if known.format != FORMAT:
        newer = known.format > FORMAT
        raise (NewerSnapshot if newer else SnapshotError)(
            f"its format is {known.format}, this program's {FORMAT}"
        )
    districts = [DistrictState(unpack(learner), hearing) for learner, hearing in known.districts]
    return ShardState(known.sharding, known.shard, districts, known.line, known.counts)
