"""Alarms: report each change of the site once, in the first version that shows it.

`AlarmLog` is given what the refit of each new version has found, and returns what is new. To learn
something for the first time is not a change: a link is reported as opened only if the window shows
that it was closed before (`change_points`), so that a new installation raises no alarms.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set

import numpy as np
from msgspec import Struct

from camtopod.arrays import rows_by_group
from camtopod.event_time import utc_text
from camtopod.learn.changes.change_points import (
    RESPONSIBILITY_MAX,
    ChangePoint,
    Trials,
    latest_change,
    threshold_nats,
)
from camtopod.learn.changes.silence import CameraSilences
from camtopod.learn.clocks import CLEAR_SD
from camtopod.learn.traffic import Scene
from camtopod.records import Alarm, Camera
from camtopod.topology import ALARMS_KEPT_MAX, mentions

SETTLING_SECONDS = 1800.0
"""Seconds after the first event in which no change is reported, as objects that were on the site
before have not been recorded yet; and seconds around the beginning and the end of a camera's
silence in which no link change is reported: objects that pass the silent camera seem to go from the
camera before it straight to the camera after it.
"""
SHARE_CHANGE_MIN = 0.1
"""Least change in the share of an open link for an alarm; smaller changes only affect the link."""


News = tuple[str, str, str]
"""Kind of a change, such as ``camera_moved``; camera, zone or link that has changed; in words."""


class AlarmState(Struct):
    """The state of an `AlarmLog`."""

    newest: list[Alarm] = []
    """The newest alarms, at most `ALARMS_KEPT_MAX`, oldest first."""
    reported: dict[str, float] = {}
    """Subject of an alarm (a zone, or a link as ``from->to``) -> time of its last report, seconds,
    while that is in the window.
    """
    joined: set[str] = set()
    """Links that were published and not reported as closed."""
    silent: dict[str, float] = {}
    """Camera reported as silent and not yet back -> time of its newest event then, seconds."""
    clock: dict[str, tuple[float, float]] = {}
    """Camera -> clock offset from which changes are measured, and its standard deviation, seconds.
    """
    repeats: dict[str, tuple[float, str]] = {}
    """Camera that repeats itself -> event time of the newest version that found it (seconds), and
    that it does, in words.
    """


class AlarmLog:
    """The alarms raised so far, and the state that lets each be raised only once."""

    def __init__(self, state: AlarmState) -> None:
        self.state = state

    def erase(self, names: Set[str]) -> None:
        """Forget these cameras, and everything that was reported of them and of their links."""
        state = self.state
        state.newest = [alarm for alarm in state.newest if not mentions(alarm.subject, names)]
        state.joined = {link for link in state.joined if not mentions(link, names)}
        for table in (state.reported, state.silent, state.clock, state.repeats):
            for subject in [subject for subject in table if mentions(subject, names)]:
                del table[subject]

    def join(self, zones: list[str], links: set[tuple[int, int]]) -> None:
        """Note links that existed without being published, so that their closing is reported.

        zones: ids of all zones.
        links: pairs of zone indices.
        """
        self.state.joined |= {f"{zones[source]}->{zones[target]}" for source, target in links}

    def add(self, version: int, t: float, news: Iterable[News]) -> None:
        """Raise alarms.

        version, t: the version that shows the changes, and its event time in seconds.
        """
        alarms = [*self.state.newest, *(Alarm(version, t, *news_item) for news_item in news)]
        self.state.newest = alarms[-ALARMS_KEPT_MAX:]

    def changes(
        self,
        t: float,
        scene: Scene,
        zones: list[str],
        cameras: list[str],
        silences: list[CameraSilences],
        changes: list[ChangePoint],
        published_pairs: set[tuple[int, int]],
        share_min: float,
    ) -> Iterator[News]:
        """Yield the new changes of cameras, zones and links.

        t (seconds): event time of the version.
        scene: the labelled events of the window.
        zones, cameras: ids of all zones, and names of all cameras.
        silences: of each camera.
        changes: of links.
        published_pairs: pairs (zone of departure, zone of arrival) of the links of this version.
        share_min: least share of the departures at a zone that makes a pair of zones a link; a zone
            is gone with less of its earlier share.
        """
        # What the window can no longer show again is forgotten.
        state = self.state
        state.reported = {
            subject: at for subject, at in state.reported.items() if at >= scene.first
        }
        present = {*zones}
        state.joined = {link for link in state.joined if present.issuperset(link.split("->"))}

        # Cameras and zones.
        begin = scene.first + SETTLING_SECONDS
        yield from self.cameras(silences, cameras, begin)
        for index, (since, before, after) in zone_changes(scene, share_min).items():
            kind = "zone_new" if after > before else "zone_gone"
            shares = f"{before:.2f} of the camera's entries or exits until {utc_text(since)}"
            if since >= begin:
                yield from self._once(t, kind, zones[index], f"{shares}, {after:.2f} since", since)

        # Links, without the changes near the beginning or end of a silence.
        edges = np.array(
            [edge for silence in silences for interval in silence.intervals for edge in interval]
        )
        link_changes = [
            c
            for c in changes
            if c.since >= begin and not np.any(np.abs(edges - c.since) < SETTLING_SECONDS)
        ]
        yield from self.links(t, link_changes, zones, published_pairs, share_min)

    def links(
        self,
        t: float,
        changes: Iterable[ChangePoint],
        zones: list[str],
        published_pairs: set[tuple[int, int]],
        share_min: float,
    ) -> Iterator[News]:
        """Yield links that opened, closed or changed their share; see `changes`."""
        joined_links = self.state.joined
        for change in changes:
            # Classify the change. Skip slight changes, closed links that had never been published,
            # and open links that are not published.
            subject = f"{zones[change.source]}->{zones[change.target]}"
            if change.after < share_min:
                kind = "link_closed"
                is_shown = subject in joined_links
            else:
                kind = "link_opened" if change.before < share_min else "link_changed"
                is_slight = abs(change.after - change.before) < SHARE_CHANGE_MIN
                is_shown = (change.source, change.target) in published_pairs
                is_shown &= not (is_slight and kind == "link_changed")
            if not is_shown:
                continue

            # Report it.
            moment = utc_text(change.since)
            detail = f"share {change.before:.2f} until {moment}, {change.after:.2f} since"
            yield from self._once(t, kind, subject, detail, change.since)
            if kind == "link_closed":
                joined_links.discard(subject)

        # Remember which links are open.
        self.join(zones, published_pairs)

    def cameras(
        self, silences: list[CameraSilences], cameras: list[str], begin: float
    ) -> Iterator[News]:
        """Yield cameras that fell silent after ``begin`` (seconds) or report again.

        A silence is also over for the test when few of the camera's events are left in the window;
        to be back, it needs a new one.
        """
        silent = self.state.silent
        for name, (intervals, lasts, newest) in zip(cameras, silences, strict=True):
            if lasts and name not in silent and intervals[-1][0] >= begin:
                silent[name] = newest
                yield "camera_silent", name, f"nothing since {utc_text(intervals[-1][0])}"
            elif newest > silent.get(name, np.inf) and not (
                intervals and intervals[-1][1] == np.inf
            ):
                del silent[name]
                yield "camera_back", name, "events again"

    def repeats(
        self, t: float, oldest: float, cameras: list[str], descriptions: list[str]
    ) -> list[News]:
        """Return the cameras that have begun to repeat themselves.

        t, oldest (seconds): event time of the version, and that of the oldest event of the window.
            A camera is free of its repetitions when the events in which they were last found have
            left the window.
        cameras, descriptions: names of all cameras, and how each repeats itself, in words.
        """
        before = self.state.repeats
        self.state.repeats = {}
        news = []
        for name, words in zip(cameras, descriptions, strict=True):
            if words:
                self.state.repeats[name] = t, words
                if name not in before:
                    detail = f"{words} What is learned from it is not real."
                    news.append(("camera_repeats", name, detail))
            elif name in before and before[name][0] >= oldest:
                self.state.repeats[name] = before[name]
        return news

    def clocks(self, cameras: list[Camera], change_min: float) -> Iterator[News]:
        """Yield cameras whose clock has moved against the others.

        cameras: records of the new version, with clock offsets.
        change_min (seconds): least change that is reported.

        A clock offset that is estimated for the first time is no change. Later estimates are
        compared with it, until a change is reported or an estimate is more than twice as exact.
        """
        for camera in cameras:
            now = camera.clock_offset
            sd = camera.clock_offset_sd
            if sd is None:
                continue
            before, before_sd = self.state.clock.get(camera.id, (now, np.inf))
            least = max(change_min, CLEAR_SD * np.hypot(sd, before_sd))
            is_clear = abs(now - before) >= least
            if is_clear:
                detail = f"ahead by {before:.2f} s before, by {now:.2f} s now"
                yield "clock_changed", camera.id, detail
            if is_clear or sd < before_sd / 2:
                self.state.clock[camera.id] = now, sd

    def _once(self, t: float, kind: str, subject: str, detail: str, since: float) -> Iterator[News]:
        """Yield a change unless it is older than the last report on its subject.

        t, since (seconds): event time of the version, and time of the change.
        """
        if since > self.state.reported.get(subject, -np.inf):
            self.state.reported[subject] = t
            yield kind, subject, detail


def zone_changes(scene: Scene, ratio_max: float) -> dict[int, tuple[float, float, float]]:
    """Find zones that are used since a moment within the window, or no longer.

    ratio_max: largest ratio of the shares before and after, the smaller over the larger.

    Return (time of the change in seconds, share before, share after) by index of the zone. The
    share is that of the zone among its camera's entries, or among its exits if the zone has more of
    these. Both together would show a change in a site that fills (entries first) or empties (exits
    last).
    """
    # Rows of the events of each camera and of each zone.
    threshold = threshold_nats(len(scene.zones), len(scene.departures.t) + len(scene.arrivals.t))
    result = {}
    cameras = max((ref.camera for ref in scene.zones), default=-1) + 1
    ends = scene.departures, scene.arrivals
    of_camera = [rows_by_group(events.camera, cameras) for events in ends]
    of_zone = [rows_by_group(events.zone, len(scene.zones)) for events in ends]

    # Test each zone's share of its camera's events, unless it has all of them.
    for index, ref in enumerate(scene.zones):
        side = int(scene.exits[index] <= scene.entries[index])
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
                np.full(len(zone_times), RESPONSIBILITY_MAX),
            ),
            threshold,
        )
        if change is not None:
            since, before, after, _ = change
            if min(before, after) <= ratio_max * max(before, after):
                result[index] = since, before, after
    return result
