"""Alarms: what has changed in the building or its cameras, said once each, in the version that
first knows it.

Finding something for the first time is no change: a link is only said to have opened when its own
past shows that it was closed (`change`), so that an installation that starts says nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Set

import numpy as np
from msgspec import Struct

from camtopod.arrays import rows_of
from camtopod.learn.changes.change_points import Change, Trials, latest_change, threshold_nats
from camtopod.learn.changes.silence import Silences
from camtopod.learn.traffic import Scene
from camtopod.records import Alarm, Camera
from camtopod.topology import ALARMS_KEPT_MAX

SUBJECTS_MAX = 10_000
"""Links and zones whose last report is remembered; beyond, the oldest is forgotten."""
SHARE_CHANGE_MIN = 0.1
"""A link that stays open is reported when its share has changed by this; smaller changes are
followed silently.
"""
STARTING_SECONDS = 1800.0
"""Nothing is reported to have changed so soon after the first event: people who were about have yet
to be seen.
"""
SILENCE_SLACK_SECONDS = 900.0
"""Links that change so near to where a camera falls silent, or is back, are taken for its work: who
passed through it unseen seems to have gone straight on.
"""
CLOCK_CHANGE_SECONDS_MIN = 0.5
CLOCK_CHANGE_SD = 4.0
"""A clock is reported when it has moved by both, the second in standard deviations."""
GONE_RATIO = 0.05
"""A zone is gone, or new, when its share of the camera's events is, or was, at most this much of
what it was, or is.
"""
ZONE_SHARE_MAX = 0.99


class AlarmState(Struct):
    """What an `AlarmLog` knows."""

    newest: list[Alarm]
    said: dict[str, float]
    joined: list[str]
    silent: list[str]
    clock: dict[str, tuple[float, float]]


class AlarmLog:
    """What has been reported, so that nothing is reported twice."""

    def __init__(self) -> None:
        self.newest: list[Alarm] = []
        """The newest `ALARMS_KEPT_MAX`, oldest first."""
        self._said: dict[
            str, float
        ] = {}  # subject -> when last reported; for what can change again
        self._joined: set[str] = (
            set()
        )  # links that have been published and not been said to have closed
        self._silent: set[str] = set()
        self._clock: dict[
            str, tuple[float, float]
        ] = {}  # offset in seconds and its sd that changes are held against

    def save(self) -> AlarmState:
        """Everything `load` needs to go on from here."""
        return AlarmState(
            self.newest, self._said, sorted(self._joined), sorted(self._silent), self._clock
        )

    def load(self, state: AlarmState) -> None:
        """Go on from there."""
        self.newest, self._said, self._clock = state.newest, state.said, state.clock
        self._joined, self._silent = set(state.joined), set(state.silent)

    def forget(self, names: Set[str]) -> None:
        """Forget which of these cameras are silent, and their clocks."""
        self._silent -= names
        for name in names & self._clock.keys():
            del self._clock[name]

    def join(self, zones: list[str], links: set[tuple[int, int]]) -> None:
        """Links that were there without having been published. ``zones``: ids."""
        self._joined |= {f"{zones[source]}->{zones[target]}" for source, target in links}

    def add(self, version: int, t: float, kind: str, subject: str, detail: str) -> None:
        """Report something found outside this module."""
        self.newest = [*self.newest, Alarm(version, t, kind, subject, detail)][-ALARMS_KEPT_MAX:]

    def report(
        self,
        version: int,
        t: float,
        scene: Scene,
        zones: list[str],
        cameras: list[str],
        silences: list[Silences],
        changes: list[Change],
        published: set[tuple[int, int]],
        share_min: float,
    ) -> None:
        """Everything that this version shows. ``zones``, ``cameras``: their ids; ``published``: the
        pairs of zones its links join; ``share_min``: a smaller share makes no link.
        """
        begun = scene.first + STARTING_SECONDS
        self.cameras(version, t, silences, cameras, begun)
        for index, change in zone_changes(scene).items():
            if change[2] >= begun:
                self.zone(version, t, zones[index], *change)
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
        """Links that opened, closed or changed. ``published``: the zones joined by the links of
        this version.
        """
        for change in changes:
            closed = change.after < share_min
            opened = not closed and change.before < share_min
            slight = not opened and abs(change.after - change.before) < SHARE_CHANGE_MIN
            subject = f"{zones[change.source]}->{zones[change.target]}"
            was_none = closed and subject not in self._joined
            is_none = not closed and (change.source, change.target) not in published
            if (slight and not closed) or was_none or is_none:
                continue
            kind = "link_closed" if closed else "link_opened" if opened else "link_changed"
            detail = f"share {change.before:.2f} until {change.since:.0f}, {change.after:.2f} since"
            self._once(version, t, kind, subject, detail, change.since)
            if closed:
                self._joined.discard(subject)
        links = {f"{zones[source]}->{zones[target]}" for source, target in published}
        self._joined = links if len(self._joined) > SUBJECTS_MAX else self._joined | links

    def zone(
        self, version: int, t: float, subject: str, before: float, after: float, since: float
    ) -> None:
        """A zone that came into use or fell out of it."""
        kind = "zone_new" if after > before else "zone_gone"
        detail = (
            f"{before:.2f} of the camera's entries or exits until {since:.0f}, {after:.2f} since"
        )
        self._once(version, t, kind, subject, detail, since)

    def cameras(
        self, version: int, t: float, silences: list[Silences], cameras: list[str], begun: float
    ) -> None:
        """Cameras that fell silent after ``begun`` (seconds), and those that are back."""
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
        """Cameras whose clock has moved against the others. What is known for the first time is no
        change.
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
        """Report a change unless what is known of the subject was known when it was last
        reported.
        """
        if since <= self._said.get(subject, -np.inf):
            return
        self._said.pop(subject, None)
        self._said[subject] = t
        if len(self._said) > SUBJECTS_MAX:
            del self._said[next(iter(self._said))]
        self.add(version, t, kind, subject, detail)


def zone_changes(scene: Scene) -> dict[int, tuple[float, float, float]]:
    """Zones whose share of their camera's events began or ended: zone -> share before, after, since
    when (seconds).

    Of entries or of exits, whichever the zone has more of: as a scene fills there are entries
    first, in the end exits.
    """
    threshold = threshold_nats(len(scene.zones), len(scene.departures.t) + len(scene.arrivals.t))
    found = {}
    cameras = max((ref.camera for ref in scene.zones), default=-1) + 1
    ends = scene.departures, scene.arrivals
    of_camera = [rows_of(events.camera, cameras) for events in ends]
    of_zone = [rows_of(events.zone, len(scene.zones)) for events in ends]
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
