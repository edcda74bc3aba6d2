"""The version line of a site that is learned in districts: parts in, merged versions out.

A version is made for each moment of event time as of which there are new parts, once all districts
have reached that moment. So versions, too, depend on the events alone. A part that arrives later,
from a shard that was away, is included from the next version on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from msgspec import Struct
from msgspec.structs import replace

from camtopod.learn import Settings
from camtopod.records import Alarm, Topology
from camtopod.sharding.merge import merge
from camtopod.sharding.parts import Part
from camtopod.topology import with_digest

AlarmKey = tuple[float, str, str, str]
"""Time, kind, subject and detail of an alarm."""


class VersionLineState(Struct):
    """State of a `VersionLine`."""

    epoch: str
    topology: Topology | None
    parts: list[Part]
    """Newest merged part of each district."""
    waiting: list[Part]
    """Parts that no version includes yet."""
    past: list[AlarmKey]
    """Alarms of earlier epochs."""


class VersionLine:
    """The version line: merges the newest part of every district."""

    def __init__(self, settings: Settings, site: str, epoch: str) -> None:
        self.settings, self.site, self.epoch = settings, site, epoch
        self.topology: Topology | None = None
        self._parts: dict[int, Part] = {}  # the newest of each district
        self._waiting: list[Part] = []
        self._past: set[AlarmKey] = set()  # alarms of earlier epochs
        self._updates: list[Topology] = []

    def take(self, parts: Iterable[Part]) -> None:
        """Add new parts."""
        self._waiting += parts

    def reach(self, until: float) -> None:
        """Make the versions up to ``until``.

        until (seconds): event time that all districts have reached.
        """
        for moment in sorted(
            {part.topology.as_of for part in self._waiting if part.topology.as_of <= until}
        ):
            for part in self._waiting:
                known = self._parts.get(part.district)
                if part.topology.as_of <= moment and (
                    known is None or age_of(known) <= age_of(part)
                ):
                    self._parts[part.district] = part
            self._waiting = [part for part in self._waiting if part.topology.as_of > moment]
            self._make()

    @property
    def waiting(self) -> int:
        """Number of parts that no version includes yet."""
        return len(self._waiting)

    def parts(self) -> list[Part]:
        """Return the newest part of each district, whether or not a version includes it."""
        newest = {part.district: part for part in (*self._parts.values(), *self._waiting)}
        return [newest[district] for district in sorted(newest)]

    def flush(self) -> None:
        """Make versions of all remaining parts."""
        self.reach(math.inf)

    def updates(self) -> list[Topology]:
        """Return the versions made since the last call, oldest first."""
        made, self._updates = self._updates, []
        return made

    def begin_epoch(self, epoch: str) -> None:
        """Begin a new epoch: versions count from 1 again, what is known stays."""
        self._past = {
            key_of(alarm) for part in self._parts.values() for alarm in part.topology.alarms or []
        }
        self.epoch, self.topology = epoch, None

    def refresh(self) -> None:
        """Make the first version of the epoch from the known parts, if there are any."""
        if self.topology is None and self._parts:
            self._make()

    def save(self) -> VersionLineState:
        """Return the state that `load` needs to continue, without updates not yet fetched."""
        parts = [self._parts[district] for district in sorted(self._parts)]
        return VersionLineState(
            self.epoch, self.topology, parts, list(self._waiting), sorted(self._past)
        )

    def load(self, state: VersionLineState) -> None:
        """Continue from a saved state; this line must be new."""
        self.epoch, self.topology, self._waiting = state.epoch, state.topology, list(state.waiting)
        self._parts = {part.district: part for part in state.parts}
        self._past = set(state.past)

    def _make(self) -> None:
        version = 1 if self.topology is None else self.topology.version + 1
        merged = merge(self._parts.values(), self.settings)

        # Alarms keep the version that first raised them.
        said = {
            key_of(alarm): alarm.version for alarm in (self.topology and self.topology.alarms) or []
        }
        alarms = [
            replace(alarm, version=said.get(key_of(alarm), version))
            for alarm in merged.alarms or []
            if key_of(alarm) not in self._past
        ]

        self.topology = with_digest(
            replace(
                merged, site=self.site, epoch=self.epoch, version=version, alarms=alarms or None
            )
        )
        self._updates.append(self.topology)


def age_of(part: Part) -> tuple[float, int]:
    """Return the age of a part: as-of time and version, to compare it with others of its district.

    A district may make two versions as of one moment.
    """
    return part.topology.as_of, part.topology.version


def key_of(alarm: Alarm) -> AlarmKey:
    """Return the content of an alarm, without the version."""
    return alarm.t, alarm.kind, alarm.subject, alarm.detail
