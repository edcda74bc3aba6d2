"""One shard of a site: the learners of its districts, with the methods of a `Learner`.

`ShardLearner` gives each event to those of its districts that it is of use to, collects the parts
that they make, and merges them into versions. What a district learns does not depend on which other
districts are in the same shard, so the parts of all shards merge into the same topology, however
many shards there are.
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
"""Format of the snapshots that this program reads and writes; other formats are refused."""
VERDICTS = ("accepted", "duplicate", "late", "refused", "unheard")
"""Verdicts of `ShardLearner.receive`; an ``unheard`` event is of no use to any district."""


class ShardState(Struct):
    """Complete state of a `ShardLearner`."""

    sharding: Sharding
    shard: tuple[int, int]
    """Number of the shard, from 0, and number of shards."""
    districts: list[DistrictState]
    """State of each district of the shard."""
    line: VersionLineState
    """State of the versions merged from the shard's own districts."""
    counts: dict[str, int]
    """Number of events by verdict."""


class ShardLearner:
    """Learner of one shard of a site: of all districts that the shard runs.

    shard: number of the shard, from 0, and number of shards.

    Its versions are merged from its own districts alone. The versions of the site are made by a
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
        # Cached result of `strangers`, and the states of the districts (`District.phase`) that it
        # belongs to.
        self._strangers: frozenset[str] = frozenset()
        self._phases: list[tuple[int | None, int, bool]] = []

    @property
    def topology(self) -> Topology | None:
        """The newest version."""
        return self._line.topology

    @property
    def epoch(self) -> str:
        """Epoch of the versions."""
        return self._line.epoch

    def listens(self, camera: str, t: float) -> bool:
        """Return True if an event of a camera at ``t`` (seconds) may be of use to any district."""
        return any(district.listens(camera, t) for district in self.districts)

    def owns(self, camera: str) -> bool:
        """Return True if a camera is assigned to one of this shard's districts."""
        return any(district.owns(camera) for district in self.districts)

    def receive(self, event: Event) -> str:
        """Receive one event and return the verdict.

        It is the verdict of the camera's own district. If that is in another shard, it is the
        verdict of the first district to which the event is of use; else ``unheard``.
        """
        verdict = "unheard"
        for district in self.districts:
            of_district = district.receive(event)
            if district.owns(event.camera) or verdict == "unheard":
                verdict = of_district
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
        """Return the newest part of each district of the shard."""
        return self._line.parts()

    @property
    def strangers(self) -> frozenset[str]:
        """Cameras that all districts of the shard with own cameras use as guests only."""
        owners = [district for district in self.districts if district.hearing.owner]
        phases = [district.phase for district in owners]
        if phases != self._phases:
            each = [district.strangers() for district in owners]
            self._phases, self._strangers = phases, frozenset(set.intersection(*each))
        return self._strangers

    def reached(self) -> float | None:
        """Return the event time (seconds) up to which all parts are made; None before any event.

        Districts without own cameras make no parts, so they do not count.
        """
        owners = [district for district in self.districts if district.hearing.owner]
        if not owners:
            watermarks = [
                mark for district in self.districts if (mark := district.watermark_us) is not None
            ]
            return max(watermarks) / MICROSECONDS if watermarks else None

        marks = [mark for district in owners if (mark := district.watermark_us) is not None]
        if not marks:
            return None
        held = [done for district in owners if (done := district.held_since_us) is not None]
        return min([max(marks), *held]) / MICROSECONDS

    def save(self) -> ShardState:
        """Return the state from which `load` continues, without versions or parts not fetched."""
        districts = [district.save_all() for district in self.districts]
        return ShardState(
            self.sharding, self.shard, districts, self._line.save(), dict(self.counts)
        )

    def load(self, state: ShardState) -> None:
        """Continue from a saved state; this learner must be new.

        Raise ValueError if the state is of another shard or of other ``[shards]`` settings.
        """
        if (state.sharding, state.shard) != (self.sharding, self.shard):
            raise ValueError(f"the state is of shard {state.shard} of {state.sharding}")
        for district, saved in zip(self.districts, state.districts, strict=True):
            district.load_all(saved)
        self._line.load(state.line)
        self.counts = dict(state.counts)

    def change(self, change: Callable[[LearnerState], LearnerState]) -> None:
        """Continue with a changed state in each district (`District.change`)."""
        for district in self.districts:
            district.change(change)

    def forget(self, names: Set[str]) -> None:
        """Forget cameras, as `Learner.forget`."""
        for district in self.districts:
            district.forget(names)

    def begin_epoch(self, epoch: str) -> None:
        """Begin an epoch: the learned state stays, versions count from 1 again."""
        self._line.begin_epoch(epoch)

    def refresh(self) -> None:
        """Make the first version of the epoch from the newest parts, if there are any."""
        self._line.refresh()

    def next_deadline(self) -> float | None:
        """Return the event time (seconds) at which the next held event is learned; None without."""
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

        ``cameras`` counts own cameras; ``window`` adds up the events of all districts' windows.
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
        """Collect new parts, and make versions up to the event time that all districts reached."""
        made = [part for district in self.districts for part in district.parts()]
        self._parts += made
        self._line.take(made)
        if self._line.waiting:
            reached = self.reached()
            if reached is not None:
                self._line.reach(reached)


class _Snapshot(Struct):
    """A snapshot as encoded: `ShardState` with the packed state of each learner."""

    format: int
    sharding: Sharding
    shard: tuple[int, int]
    districts: list[tuple[bytes, Membership]]
    line: VersionLineState
    counts: dict[str, int]


def pack_shard(state: ShardState) -> bytes:
    """Return a shard's state as compressed bytes."""
    districts = [(pack(district.learner), district.hearing) for district in state.districts]
    plain = _Snapshot(FORMAT, state.sharding, state.shard, districts, state.line, state.counts)
    return zlib.compress(msgspec.msgpack.encode(plain), 1)


def unpack_shard(blob: bytes) -> ShardState:
    """Return a shard's state from bytes made by `pack_shard`.

    Raise `SnapshotError` if the bytes are damaged, `NewerSnapshot` if a newer program wrote them.
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
