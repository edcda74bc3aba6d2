"""One shard of a site: the districts it works and, of what they learn, a topology. In place of a
`Learner`.

What each district learns does not depend on which others are in the same shard, so the parts of all
shards merge into the same topology however many there are.
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
from camtopod.sharding.assignment import Dealing, Sharding, districts_of
from camtopod.sharding.district_learner import District, DistrictState, Hearing
from camtopod.sharding.parts import Part
from camtopod.sharding.version_line import Line, LineState

FORMAT = 1
"""Of a shard's snapshot: one with a higher number is refused."""
VERDICTS = ("accepted", "duplicate", "late", "refused", "unheard")


class ShardState(Struct):
    """Everything a `ShardLearner` knows."""

    sharding: Sharding
    shard: tuple[int, int]
    districts: list[DistrictState]
    line: LineState
    counts: dict[str, int]


class ShardLearner:
    """Shard ``shard`` = (i, n) of a site: i of 0 .. n - 1. Its versions are of its own districts
    alone; what a site's `Line` merges are the parts of all its shards.
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
        dealing = Dealing(self.sharding)
        self.districts = [
            District(self.settings, site, epoch, dealing, number)
            for number in districts_of(*shard, self.sharding.districts)
        ]
        self.counts = dict.fromkeys(VERDICTS, 0)
        self._line = Line(self.settings, site, epoch)
        self._parts: list[Part] = []
        self._phases: list[
            tuple[int | None, int, bool]
        ] = []  # those in which the strangers were found
        self._strangers: frozenset[str] = frozenset()

    @property
    def topology(self) -> Topology | None:
        """The newest version."""
        return self._line.topology

    @property
    def epoch(self) -> str:
        """Of the versions."""
        return self._line.epoch

    def listens(self, camera: str, t: float) -> bool:
        """Whether any district has use for an event at ``t`` (seconds) of the camera."""
        return any(district.listens(camera, t) for district in self.districts)

    def owns(self, camera: str) -> bool:
        """Whether the camera is one of this shard's."""
        return any(district.owns(camera) for district in self.districts)

    def receive(self, event: Event) -> str:
        """Take one event; the verdict is that of the camera's own district, of another one that
        heard it where it is in another shard, or ``unheard``.
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
        """Event time has come to ``now`` (seconds) although no event says so."""
        for district in self.districts:
            district.advance(now)
        self._merge()

    def flush(self) -> None:
        """The end of a recording: learn what is still held and make a last version."""
        for district in self.districts:
            district.flush()
        self._merge()
        self._line.flush()

    def updates(self) -> list[Topology]:
        """Versions made since the last call, oldest first."""
        return self._line.updates()

    def parts(self) -> list[Part]:
        """Parts made since the last call, for the site's `Line`; ask for them before `reached`."""
        made, self._parts = self._parts, []
        return made

    def newest_parts(self) -> list[Part]:
        """The newest part of each of its districts."""
        return self._line.parts()

    @property
    def strangers(self) -> frozenset[str]:
        """Cameras that none of its districts that have cameras of their own has use for, but as
        guests.
        """
        owners = [district for district in self.districts if district.hearing.owner]
        phases = [district.phase for district in owners]
        if phases != self._phases:
            each = [district.strangers() for district in owners]
            self._phases, self._strangers = phases, frozenset(set.intersection(*each))
        return self._strangers

    def reached(self) -> float | None:
        """Event time (seconds) up to which all parts have been made; None before anything has come.
        A district that only hears others has no parts to wait for.
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
        """Everything `load` needs to go on from here. Updates and parts that have not been asked
        for are not in it.
        """
        districts = [district.save_all() for district in self.districts]
        return ShardState(
            self.sharding, self.shard, districts, self._line.save(), dict(self.counts)
        )

    def load(self, state: ShardState) -> None:
        """Go on from there; this one must be new, of the same shard, and dealt out alike."""
        if (state.sharding, state.shard) != (self.sharding, self.shard):
            raise ValueError(f"the state is of shard {state.shard} of {state.sharding}")
        for district, saved in zip(self.districts, state.districts, strict=True):
            district.load_all(saved)
        self._line.load(state.line)
        self.counts = dict(state.counts)

    def change(self, change: Callable[[LearnerState], LearnerState]) -> None:
        """Let each district go on with another state."""
        for district in self.districts:
            district.change(change)

    def forget(self, names: Set[str]) -> None:
        """Forget cameras, as `Learner.forget`."""
        for district in self.districts:
            district.forget(names)

    def begin_epoch(self, epoch: str) -> None:
        """What is known stays; versions count from 1 again."""
        self._line.begin_epoch(epoch)

    def refresh(self) -> None:
        """Make the first version of the epoch of what is known already, if anything is."""
        self._line.refresh()

    def next_deadline(self) -> float | None:
        """Event time (seconds) to which `advance` would have to go for something to happen; None:
        nothing waits.
        """
        waiting = [
            due for district in self.districts if (due := district.next_deadline()) is not None
        ]
        return min(waiting, default=None)

    def event_time(self) -> EventTimeState:
        """How far event time has come in the district that has come furthest."""
        return max(
            (one.event_time() for one in self.districts), key=lambda state: state.watermark_us or 0
        )

    def statistics(self) -> dict[str, int | float]:
        """Counts and sizes, for people and for health checks. Cameras are own ones; windows are
        those of all districts together.
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
        """New parts into the version line, as far as all districts have come."""
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
    districts: list[tuple[bytes, Hearing]]
    line: LineState
    counts: dict[str, int]


def pack_shard(state: ShardState) -> bytes:
    """The state as bytes, compressed."""
    districts = [(pack(district.learner), district.hearing) for district in state.districts]
    plain = _Snapshot(FORMAT, state.sharding, state.shard, districts, state.line, state.counts)
    return zlib.compress(msgspec.msgpack.encode(plain), 1)


def unpack_shard(blob: bytes) -> ShardState:
    """The state from bytes; raises `SnapshotError`."""
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
