"""Alarms: changes of the site, each raised once, in the first version that shows it.

A first finding is not a change: a link is reported as opened only if its own past shows that it was
closed (`change_points`), so that a new installation raises no alarms.
"""

from __future__ import annotations

from collections.abc import Iterable, Set

import numpy as np
from msgspec import Struct

from camtopod.arrays import rows_by_group
from camtopod.learn.changes.change_points import Change, Trials, latest_change, threshold_nats
from camtopod.learn.changes.silence import CameraSilences
from camtopod.learn.traffic import Scene
from camtopod.records import Alarm, Camera
from camtopod.topology import ALARMS_KEPT_MAX

SUBJECTS_MAX = 10_000
"""Links and zones whose last report is remembered; beyond, the oldest is forgotten."""
SHARE_CHANGE_MIN = 0.1
"""Least change in the share of an open link that is reported; smaller ones are followed only."""
STARTING_SECONDS = 1800.0
"""Time after the first event, seconds, in which no change is reported.

Objects that were in the building before have yet to be seen.
"""
SILENCE_SLACK_SECONDS = 900.0
"""Time around either end of a camera's silence in which no link change is reported, seconds.

Such changes are an effect of the silence: objects that pass the silent camera seem to go straight
on.
"""
CLOCK_CHANGE_SECONDS_MIN = 0.5
"""Least change of a clock offset that is reported, seconds."""
CLOCK_CHANGE_SD = 4.0
"""Least change of a clock offset that is reported, in standard deviations."""
GONE_RATIO = 0.05
"""Largest ratio of a zone's shares of its camera's events for the zone to be new or gone.

The ratio is that of the smaller share to the larger, before and after the change.
"""
ZONE_SHARE_MAX = 0.99
"""Responsibility given to each event of a zone: the evidence of one event is limited."""


class AlarmState(Struct):
    """State of an `AlarmLog`, as saved."""

    newest: list[Alarm]
    """Alarms, oldest first."""
    said: dict[str, float]
    """Subject -> time of its last report, seconds."""
    joined: list[str]
    """Links that were published and not reported as closed."""
    silent: list[str]
    """Cameras reported as silent and not yet back."""
    clock: dict[str, tuple[float, float]]
    """Camera -> clock offset and its standard deviation (seconds) to measure changes from."""


class AlarmLog:
    """The alarms raised so far, and what is needed to raise each only once."""

    def __init__(self) -> None:
        self.newest: list[Alarm] = []
        """The newest alarms, at most `ALARMS_KEPT_MAX`, oldest first."""

        # The other fields are described at `AlarmState`.
        self._said: dict[str, float] = {}
        self._joined: set[str] = set()
        self._silent: set[str] = set()
        self._clock: dict[str, tuple[float, float]] = {}

    def save(self) -> AlarmState:
        """Return the state that `load` needs to continue."""
        return AlarmState(
            self.newest, self._said, sorted(self._joined), sorted(self._silent), self._clock
        )

    def load(self, state: AlarmState) -> None:
        """Continue from a saved state."""
        self.newest, self._said, self._clock = state.newest, state.said, state.clock
        self._joined, self._silent = set(state.joined), set(state.silent)

    def forget(self, names: Set[str]) -> None:
        """Forget whether these cameras are silent, and their clock offsets."""
        self._silent -= names
        for name in names & self._clock.keys():
            del self._clock[name]

    def join(self, zones: list[str], links: set[tuple[int, int]]) -> None:
        """Note links that existed without having been published, so that their closing is reported.

        zones: ids of all zones.
        links: pairs of zone indices.
        """
        self._joined |= {f"{zones[source]}->{zones[target]}" for source, target in links}

    def add(self, version: int, t: float, kind: str, subject: str, detail: str) -> None:
        """Raise an alarm for a change that was found elsewhere."""
        self.newest = [*self.newest, Alarm(version, t, kind, subject, detail)][-ALARMS_KEPT_MAX:]

    def report(
        self,
        version: int,
        t: float,
        scene: Scene,
        zones: list[str],
        cameras: list[str],
        silences: list[CameraSilences],
        changes: list[Change],
        published: set[tuple[int, int]],
        share_min: float,
    ) -> None:
        """Raise the alarms for all changes that this version shows.

        t (seconds): event time of the version.
        zones, cameras: their ids.
        published: pairs of zones that the links of this version join.
        share_min: a pair of zones with a smaller share is no link.
        """
        # Cameras and zones.
        begun = scene.first + STARTING_SECONDS
        self.cameras(version, t, silences, cameras, begun)
        for index, change in zone_changes(scene).items():
            if change[2] >= begun:
                self.zone(version, t, zones[index], *change)

        # Links, without the changes near the beginning or end of a silence.
        edges = np.array(
            [edge for silence in silences for interval in silence.intervals for edge in interval]
        )
        own = [
            c
            for c in changes
            if c.since >= begun and not np.any(np.abs(edges - c.since) < SILENCE_SLACK_SECONDS)
        ]
        self.links(version, t, own, zones, published, share_min)

    def links(
        self,
        version: int,
        t: float,
        changes: Iterable[Change],
        zones: list[str],
        published: set[tuple[int, int]],
        share_min: float,
    ) -> None:
        """Raise the alarms for links that opened, closed or changed.

        published: pairs of zones that the links of this version join.
        """
        for change in changes:
            # Classify the change; skip slight ones, and pairs of zones that are no link or were
            # none.
            closed = change.after < share_min
            opened = not closed and change.before < share_min
            slight = not opened and abs(change.after - change.before) < SHARE_CHANGE_MIN
            subject = f"{zones[change.source]}->{zones[change.target]}"
            was_none = closed and subject not in self._joined
            is_none = not closed and (change.source, change.target) not in published
            if (slight and not closed) or was_none or is_none:
                continue

            # Report it.
            kind = "link_closed" if closed else "link_opened" if opened else "link_changed"
            detail = f"share {change.before:.2f} until {change.since:.0f}, {change.after:.2f} since"
            self._once(version, t, kind, subject, detail, change.since)
            if closed:
                self._joined.discard(subject)

        # Remember which links are open.
        links = {f"{zones[source]}->{zones[target]}" for source, target in published}
        self._joined = links if len(self._joined) > SUBJECTS_MAX else self._joined | links

    def zone(
        self, version: int, t: float, subject: str, before: float, after: float, since: float
    ) -> None:
        """Raise the alarm for a zone that came into use or fell out of it.

        before, after: its share of the camera's entries or exits.
        since (seconds): time of the change.
        """
        kind = "zone_new" if after > before else "zone_gone"
        detail = (
            f"{before:.2f} of the camera's entries or exits until {since:.0f}, {after:.2f} since"
        )
        self._once(version, t, kind, subject, detail, since)

    def cameras(
        self,
        version: int,
        t: float,
        silences: list[CameraSilences],
        cameras: list[str],
        begun: float,
    ) -> None:
        """Raise the alarms for cameras that fell silent after ``begun`` (seconds) or are back."""
        for name, silence in zip(cameras, silences, strict=True):
            ongoing = bool(silence.intervals) and silence.intervals[-1][1] == np.inf
            if silence.lasts and name not in self._silent and silence.intervals[-1][0] >= begun:
                self._silent.add(name)
                self.add(
                    version,
                    t,
                    "camera_silent",
                    name,
                    f"nothing since {silence.intervals[-1][0]:.0f}",
                )
            elif name in self._silent and not ongoing:
                self._silent.discard(name)
                self.add(version, t, "camera_back", name, "events again")

    def clocks(self, version: int, t: float, cameras: list[Camera]) -> None:
        """Raise the alarms for cameras whose clock has moved against the others.

        A clock offset that is estimated for the first time is no change. The offset that later ones
        are compared with is replaced when a change is reported, or when the new estimate is more
        than twice as exact.
        """
        for camera in cameras:
            now, sd = camera.clock_offset, camera.clock_offset_sd
            if sd is None:
                continue
            before, before_sd = self._clock.get(camera.id, (now, np.inf))
            moved = abs(now - before)
            clear = moved >= CLOCK_CHANGE_SECONDS_MIN and moved > CLOCK_CHANGE_SD * np.hypot(
                sd, before_sd
            )
            if clear:
                self.add(
                    version,
                    t,
                    "clock_changed",
                    camera.id,
                    f"ahead by {before:.2f} s before, by {now:.2f} s now",
                )
            if clear or sd < before_sd / 2:
                self._clock[camera.id] = now, sd

    def _once(
        self, version: int, t: float, kind: str, subject: str, detail: str, since: float
    ) -> None:
        """Raise an alarm unless the change happened before the last report on its subject."""
        if since <= self._said.get(subject, -np.inf):
            return
        self._said.pop(subject, None)
        self._said[subject] = t
        if len(self._said) > SUBJECTS_MAX:
            del self._said[next(iter(self._said))]
        self.add(version, t, kind, subject, detail)


def zone_changes(scene: Scene) -> dict[int, tuple[float, float, float]]:
    """Return the zones whose share of their camera's events began or ended.

    Maps zone -> share before, share after, time of the change (seconds). Entries or exits are
    judged, whichever the zone has more of; judging both together would mistake a scene that fills
    (entries first) or empties (exits last) for a change.
    """
    # Rows of the events of each camera and of each zone.
    threshold = threshold_nats(len(scene.zones), len(scene.departures.t) + len(scene.arrivals.t))
    found = {}
    cameras = max((ref.camera for ref in scene.zones), default=-1) + 1
    ends = scene.departures, scene.arrivals
    of_camera = [rows_by_group(events.camera, cameras) for events in ends]
    of_zone = [rows_by_group(events.zone, len(scene.zones)) for events in ends]

    # Test each zone's share of its camera's events, unless it has all of them.
    for index, ref in enumerate(scene.zones):
        side = 0 if scene.exits[index] > scene.entries[index] else 1
        seen, own = (
            ends[side].t[rows] for rows in (of_camera[side][ref.camera], of_zone[side][index])
        )
        if len(own) == len(seen):
            continue
        change = latest_change(
            Trials(seen, np.ones(len(seen)), own, np.full(len(own), ZONE_SHARE_MAX)), threshold
        )
        if change is not None:
            since, before, after, _ = change
            if min(before, after) <= GONE_RATIO * max(before, after):
                found[index] = before, after, since
    return found
