"""The version line of a site that is learned in districts: receives parts, makes merged versions.

Each part is as of some moment of event time. For each such moment, a version is made once all
districts have reached it. So versions depend on the events alone, not on the order in which parts
are received. A part that is received later, from a shard that was not running, is included from the
next version on.
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
    """The saved state of a `VersionLine`."""

    epoch: str
    topology: Topology | None
    """The newest version."""
    parts: list[Part]
    """Newest merged part of each district."""
    waiting: list[Part]
    """Parts that no version includes yet."""
    past: list[AlarmKey]
    """Alarms of earlier epochs."""


class VersionLine:
    """Merges the newest part of every district into versions of the site.

    topology: the newest version; None before the first one of the epoch.
    """

    def __init__(self, settings: Settings, site: str, epoch: str) -> None:
        self.settings, self.site, self.epoch = settings, site, epoch
        self.topology: Topology | None = None
        self._parts: dict[int, Part] = {}  # the newest of each district
        self._waiting: list[Part] = []
        self._past: set[AlarmKey] = set()  # alarms of earlier epochs
        self._updates: list[Topology] = []

    def take(self, parts: Iterable[Part]) -> None:
        """Add new parts; versions are made of them by `reach`."""
        self._waiting += parts

    def reach(self, until: float) -> None:
        """Make the versions as of moments up to ``until``.

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
        """Make versions of all waiting parts."""
        self.reach(math.inf)

    def updates(self) -> list[Topology]:
        """Return the versions made since the last call, oldest first."""
        made, self._updates = self._updates, []
        return made

    def begin_epoch(self, epoch: str) -> None:
        """Begin an epoch: the parts stay, versions count from 1 again."""
        self._past = {
            key_of(alarm) for part in self._parts.values() for alarm in part.topology.alarms or []
        }
        self.epoch, self.topology = epoch, None

    def refresh(self) -> None:
        """Make the first version of the epoch from the merged parts, if there are any.

        If the epoch has a version already, do nothing.
        """
        if self.topology is None and self._parts:
            self._make()

    def save(self) -> VersionLineState:
        """Return the state from which `load` continues, without versions not fetched yet."""
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
        """Make the next version from the newest parts."""
        version = 1 if self.topology is None else self.topology.version + 1
        merged = merge(self._parts.values(), self.settings)

        # Alarms keep the version that first raised them.
        first_raised = {
            key_of(alarm): alarm.version for alarm in (self.topology and self.topology.alarms) or []
        }
        alarms = [
            replace(alarm, version=first_raised.get(key_of(alarm), version))
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
    """Return (as-of time, version) of a part, by which parts of one district are ordered.

    A district may make two versions as of one moment.
    """
    return part.topology.as_of, part.topology.version


def key_of(alarm: Alarm) -> AlarmKey:
    """Return the key by which an alarm is recognised in a later version: all but its version."""
    return alarm.t, alarm.kind, alarm.subject, alarm.detail
