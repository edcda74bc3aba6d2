"""The version line of a site that is learned in districts: parts go in as they are made, merged
versions come out.

A version is made for each moment of event time as of which there are new parts, once all districts
have come so far: so versions, too, follow from the events alone. A part that comes later than that,
from a shard that was away, counts from the next version on.
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
from camtopod.topology import stamp

AlarmKey = tuple[float, str, str, str]


class LineState(Struct):
    """What a `Line` knows."""

    epoch: str
    topology: Topology | None
    parts: list[Part]
    waiting: list[Part]
    past: list[AlarmKey]


class Line:
    """Merges the newest part of every district."""

    def __init__(self, settings: Settings, site: str, epoch: str) -> None:
        self.settings, self.site, self.epoch = settings, site, epoch
        self.topology: Topology | None = None
        self._parts: dict[int, Part] = {}  # the newest of each district
        self._waiting: list[Part] = []
        self._past: set[AlarmKey] = set()  # alarms of earlier epochs
        self._updates: list[Topology] = []

    def take(self, parts: Iterable[Part]) -> None:
        """New parts."""
        self._waiting += parts

    def reach(self, until: float) -> None:
        """All districts have come to ``until`` (seconds): make the versions up to then."""
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
        """Parts that no version has yet."""
        return len(self._waiting)

    def parts(self) -> list[Part]:
        """The newest part of each district, whether or not a version has it yet."""
        newest = {part.district: part for part in (*self._parts.values(), *self._waiting)}
        return [newest[district] for district in sorted(newest)]

    def flush(self) -> None:
        """Nothing more is to come."""
        self.reach(math.inf)

    def updates(self) -> list[Topology]:
        """Versions made since the last call, oldest first."""
        made, self._updates = self._updates, []
        return made

    def begin_epoch(self, epoch: str) -> None:
        """What is known stays; versions count from 1 again."""
        self._past = {
            key_of(alarm) for part in self._parts.values() for alarm in part.topology.alarms or []
        }
        self.epoch, self.topology = epoch, None

    def refresh(self) -> None:
        """Make the first version of the epoch of what is known already, if anything is."""
        if self.topology is None and self._parts:
            self._make()

    def save(self) -> LineState:
        """Everything `load` needs to go on from here. Updates that have not been asked for are not
        in it.
        """
        parts = [self._parts[district] for district in sorted(self._parts)]
        return LineState(self.epoch, self.topology, parts, list(self._waiting), sorted(self._past))

    def load(self, state: LineState) -> None:
        """Go on from there; this line must be new."""
        self.epoch, self.topology, self._waiting = state.epoch, state.topology, list(state.waiting)
        self._parts = {part.district: part for part in state.parts}
        self._past = set(state.past)

    def _make(self) -> None:
        version = 1 if self.topology is None else self.topology.version + 1
        merged = merge(self._parts.values(), self.settings)
        said = {
            key_of(alarm): alarm.version for alarm in (self.topology and self.topology.alarms) or []
        }
        alarms = [
            replace(alarm, version=said.get(key_of(alarm), version))
            for alarm in merged.alarms or []
            if key_of(alarm) not in self._past
        ]
        self.topology = stamp(
            replace(
                merged, site=self.site, epoch=self.epoch, version=version, alarms=alarms or None
            )
        )
        self._updates.append(self.topology)


def age_of(part: Part) -> tuple[float, int]:
    """What tells a part from an older one of its district, which may make two versions as of one
    moment.
    """
    return part.topology.as_of, part.topology.version


def key_of(alarm: Alarm) -> AlarmKey:
    """What an alarm says, whichever version says it."""
    return alarm.t, alarm.kind, alarm.subject, alarm.detail
