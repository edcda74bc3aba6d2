"""Alarms: report each change of the site once, in the first version that shows it.

`AlarmLog.report` is called with each new version and what its refit has found. To learn something
for the first time is not a change: a link is reported as opened only if the window shows that it
was closed before (`change_points`), so that a new installation raises no alarms.
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
from camtopod.topology import ALARMS_KEPT_MAX, mentions

SUBJECTS_MAX = 10_000
"""Links and zones whose last report is remembered; beyond, the oldest is forgotten."""
SHARE_CHANGE_MIN = 0.1
"""Least change in the share of an open link for an alarm; smaller changes only affect the link."""
STARTING_SECONDS = 1800.0
"""Seconds after the first event in which no change is reported.

Objects that were on the site before have not been recorded yet.
"""
SILENCE_SLACK_SECONDS = 900.0
"""Seconds around the beginning and the end of a camera's silence in which no link change is
reported.

Such changes are an effect of the silence: objects that pass the silent camera seem to go from the
camera before it straight to the camera after it.
"""
CLOCK_CHANGE_SECONDS_MIN = 0.5
"""Least change of a clock offset that is reported, seconds."""
CLOCK_CHANGE_SD = 4.0
"""Least change of a clock offset that is reported, in standard deviations."""
GONE_RATIO = 0.05
"""Largest ratio, for a zone to be reported as new or gone, of its share of the camera's events
before a change and its share after, the smaller over the larger.
"""
ZONE_SHARE_MAX = 0.99
"""Responsibility given to each event of a zone in the test for changes.

It is below 1, so that the evidence of a single event is limited.
"""


class AlarmState(Struct):
    """The state of an `AlarmLog`."""

    newest: list[Alarm] = []
    """The newest alarms, at most `ALARMS_KEPT_MAX`, oldest first."""
    said: dict[str, float] = {}
    """Subject of an alarm (a zone, or a link as ``from->to``) -> time of its last report, seconds.
    """
    joined: set[str] = set()
    """Links that were published and not reported as closed."""
    silent: set[str] = set()
    """Cameras reported as silent and not yet back."""
    clock: dict[str, tuple[float, float]] = {}
    """Camera -> clock offset from which changes are measured, and its standard deviation, seconds.
    """


class AlarmLog:
    """The alarms raised so far, and the state that lets each be raised only once."""

    def __init__(self, state: AlarmState) -> None:
        self.state = state

    def forget(self, names: Set[str]) -> None:
        """Forget whether these cameras are silent, and their clock offsets."""
        self.state.silent -= names
        for name in names & self.state.clock.keys():
            del self.state.clock[name]

    def erase(self, names: Set[str]) -> None:
        """Forget these cameras, and everything that was reported of them and of their links."""
        self.forget(names)
        self.state.newest = [
            alarm for alarm in self.state.newest if not mentions(alarm.subject, names)
        ]
        self.state.said = {
            subject: t for subject, t in self.state.said.items() if not mentions(subject, names)
        }
        self.state.joined = {link for link in self.state.joined if not mentions(link, names)}

    def join(self, zones: list[str], links: set[tuple[int, int]]) -> None:
        """Note links that existed without being published, so that their closing is reported.

        zones: ids of all zones.
        links: pairs of zone indices.
        """
        self.state.joined |= {f"{zones[source]}->{zones[target]}" for source, target in links}

    def add(self, version: int, t: float, kind: str, subject: str, detail: str) -> None:
        """Raise an alarm for a change that the caller has found.

        version, t: the version that shows the change, and its event time in seconds.
        kind: kind of the change, such as ``camera_moved``.
        subject: the camera, zone or link that has changed.
        detail: the change in words.
        """
        self.state.newest = [*self.state.newest, Alarm(version, t, kind, subject, detail)][
            -ALARMS_KEPT_MAX:
        ]

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
        scene: the labelled events of the window.
        zones, cameras: ids of all zones, and names of all cameras.
        silences: of each camera.
        changes: of links.
        published: pairs (zone of departure, zone of arrival) of the links of this version.
        share_min: least share of the departures at a zone that makes a pair of zones a link.
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
        link_changes = [
            c
            for c in changes
            if c.since >= begun and not np.any(np.abs(edges - c.since) < SILENCE_SLACK_SECONDS)
        ]
        self.links(version, t, link_changes, zones, published, share_min)

    def links(
        self,
        version: int,
        t: float,
        changes: Iterable[Change],
        zones: list[str],
        published: set[tuple[int, int]],
        share_min: float,
    ) -> None:
        """Raise the alarms for links that opened, closed or changed their share.

        Arguments are as for `report`.
        """
        for change in changes:
            # Classify the change. Skip slight changes, closed links that had never been published,
            # and open links that are not published.
            closed = change.after < share_min
            opened = not closed and change.before < share_min
            slight = not opened and abs(change.after - change.before) < SHARE_CHANGE_MIN
            subject = f"{zones[change.source]}->{zones[change.target]}"
            was_none = closed and subject not in self.state.joined
            is_none = not closed and (change.source, change.target) not in published
            if (slight and not closed) or was_none or is_none:
                continue

            # Report it.
            kind = "link_closed" if closed else "link_opened" if opened else "link_changed"
            detail = f"share {change.before:.2f} until {change.since:.0f}, {change.after:.2f} since"
            self._once(version, t, kind, subject, detail, change.since)
            if closed:
                self.state.joined.discard(subject)

        # Remember which links are open.
        links = {f"{zones[source]}->{zones[target]}" for source, target in published}
        self.state.joined = (
            links if len(self.state.joined) > SUBJECTS_MAX else self.state.joined | links
        )

    def zone(
        self, version: int, t: float, subject: str, before: float, after: float, since: float
    ) -> None:
        """Raise the alarm for a zone that is used since a moment, or no longer.

        subject: id of the zone.
        before, after: the zone's share of its camera's entries or exits until then and since.
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
        """Raise alarms for cameras that fell silent after ``begun`` (seconds) or report again."""
        silent = self.state.silent
        for name, silence in zip(cameras, silences, strict=True):
            ongoing = bool(silence.intervals) and silence.intervals[-1][1] == np.inf
            if (
                silence.lasts
                and name not in self.state.silent
                and silence.intervals[-1][0] >= begun
            ):
                silent.add(name)
                self.add(
                    version,
                    t,
                    "camera_silent",
                    name,
                    f"nothing since {silence.intervals[-1][0]:.0f}",
                )
            elif name in silent and not ongoing:
                silent.discard(name)
                self.add(version, t, "camera_back", name, "events again")

    def clocks(self, version: int, t: float, cameras: list[Camera]) -> None:
        """Raise the alarms for cameras whose clock has moved against the others.

        cameras: records of the new version, with clock offsets.

        A clock offset that is estimated for the first time is no change. Later estimates are
        compared with it, until a change is reported or an estimate is more than twice as exact.
        """
        for camera in cameras:
            now = camera.clock_offset
            sd = camera.clock_offset_sd
            if sd is None:
                continue
            before, before_sd = self.state.clock.get(camera.id, (now, np.inf))
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
                self.state.clock[camera.id] = now, sd

    def _once(
        self, version: int, t: float, kind: str, subject: str, detail: str, since: float
    ) -> None:
        """Raise an alarm unless the change is older than the last report on its subject.

        since (seconds): time of the change; the other arguments are as for `add`.
        """
        if since <= self.state.said.get(subject, -np.inf):
            return
        self.state.said.pop(subject, None)
        self.state.said[subject] = t
        if len(self.state.said) > SUBJECTS_MAX:
            del self.state.said[next(iter(self.state.said))]
        self.add(version, t, kind, subject, detail)


def zone_changes(scene: Scene) -> dict[int, tuple[float, float, float]]:
    """Find zones that are used since a moment within the window, or no longer.

    Return (share before, share after, time of the change in seconds) by index of the zone. The
    share is that of the zone among its camera's entries, or among its exits if the zone has more of
    these. Both together would show a change in a site that fills (entries first) or empties (exits
    last).
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
        camera_times, zone_times = (
            ends[side].t[rows] for rows in (of_camera[side][ref.camera], of_zone[side][index])
        )
        if len(zone_times) == len(camera_times):
            continue
        change = latest_change(
            Trials(
                camera_times,
                np.ones(len(camera_times)),
                zone_times,
                np.full(len(zone_times), ZONE_SHARE_MAX),
            ),
            threshold,
        )
        if change is not None:
            since, before, after, _ = change
            if min(before, after) <= GONE_RATIO * max(before, after):
                found[index] = before, after, since
    return found
