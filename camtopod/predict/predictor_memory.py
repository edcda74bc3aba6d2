"""The memory of a predictor: the arrivals, exits and passages that it has observed, by one version.

Each arrival has the rate of all its known causes: the objects that have left other views, and those
that are still in them. An outlook takes from it what the object itself has (`outlook.Seen`). Events
may be heard in any order: the rates are those of the order of time, but for guesses where an object
was before. `Reporting` tells which cameras still report.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from camtopod.arrays import Floats, Rows
from camtopod.predict.labels import UNKNOWN_LABEL
from camtopod.predict.outlook import Departure, Seen
from camtopod.predict.passages import UNKNOWN, Passage, RecentPassages
from camtopod.predict.recent_events import (
    RECENT_MAX,
    RecentEvents,
    RecentState,
    moved_zones,
)
from camtopod.predict.version import PreparedVersion
from camtopod.records import Event

DEAD_PRIOR = 1e-3
"""Prior probability that a camera has stopped reporting for good."""
SILENCE_NATS_MAX = 50.0
"""Largest evidence (nats) of a camera's silence that counts."""


class PredictorState(Struct):
    """The saved state of a `Predictor`: the observed events; the rest follows from its topology.

    arrivals, exits: the newest arrivals and exits.
    under_way: open passages, as (camera, track, passage).
    events: number of observed events.
    last_event: number of each camera's last event in the order of all events.
    since: time of the first observed event (corrected, seconds); infinite without one.

    Ended passages are left out: they only matter if a prediction is asked for again.
    """

    arrivals: RecentState
    exits: RecentState
    under_way: list[tuple[str, str, Passage]]
    events: int
    last_event: dict[str, int]
    since: float = -math.inf


class PredictorMemory:
    """The observed events; all times inside are corrected times.

    version: the prepared topology version.
    """

    def __init__(self, version: PreparedVersion) -> None:
        self._version = version
        self.passages = RecentPassages(version.longest_stays())
        self.arrivals, self.exits = RecentEvents(), RecentEvents()
        self._reporting = Reporting(version.cameras, version.event_share)
        self._since = math.inf

    def take_over(self, older: PredictorMemory) -> None:
        """Take over the observed events from a memory by an older version; this must be new."""
        new_zones = moved_zones(older._version.zones, self._version.zones)
        labels = self._version.labels.moved(older._version.labels)
        self.arrivals.take_over(older.arrivals, new_zones, labels)
        self.exits.take_over(older.exits, new_zones, labels)
        self.passages.take_over(older.passages, new_zones, labels)
        self._reporting.load(older._reporting.events, older._reporting.last_events())
        self._since = older._since

    def save(self) -> PredictorState:
        """Return the state from which `load` continues, given the same version."""
        return PredictorState(
            arrivals=self.arrivals.save(),
            exits=self.exits.save(),
            under_way=[(*key, passage) for key, passage in self.passages.open.passages()],
            events=self._reporting.events,
            last_event=self._reporting.last_events(),
            since=self._since,
        )

    def load(self, state: PredictorState) -> None:
        """Continue from a state saved with the same version; this must be new."""
        self.arrivals.load(state.arrivals)
        self.exits.load(state.exits)
        for camera, track, passage in state.under_way:
            self.passages.open.begin(camera, track, passage)
        self._reporting.load(state.events, state.last_event)
        self._since = state.since

    def observe(self, event: Event, zone: int | None) -> None:
        """Observe an event; ``zone`` is the index of its zone, None if its camera has no zone."""
        self._reporting.note(None if zone is None else int(self._version.camera_of[zone]))
        if zone is None:
            return
        t = event.t - self._version.clock_offset[event.camera]
        self._since = min(self._since, t)
        if event.kind == "entry":
            self._observe_entry(event, zone, t)
        else:
            self._observe_exit(event, zone, t)

    # --- The question ---

    def seen(self, departure: Departure) -> Seen:
        """Return the observed arrivals that may be of an object, by the moment of a question.

        Two filters are used. Before the exit, arrivals count at zones where an object that leaves
        at the zone of the exit may have appeared already (`_arrivals_before`). Since the exit,
        arrivals at all zones count. An arrival before the object's entry into the view never does.
        """
        # Before the exit. An arrival at the very moment of the object's entry (tied) counts only if
        # its passage has not ended before the exit: of two passages that begin together, the one
        # that ends first counts as the earlier one (`_is_open`).
        arrivals, zone, t = self.arrivals, departure.zone, departure.t
        rows = self._arrivals_before(zone, t, departure.began)
        simultaneous_rows = rows[arrivals.t[rows] == departure.began]
        if len(simultaneous_rows):
            rows = np.setdiff1d(
                rows, [row for row in simultaneous_rows if not self._is_open(row, t)]
            )
        before = len(rows)
        memory_start = min(self._since - t, 0.0)

        # Since the exit, as far as they are reported by the moment of the question.
        if departure.elapsed:
            report_t = self._reported(zone)
            since = (report_t >= t) & (report_t <= t + departure.elapsed)
            since &= arrivals.t >= departure.began
            rows = np.concatenate((rows, np.flatnonzero(since)))
            if len(arrivals.t) == RECENT_MAX:  # older ones may have been forgotten
                memory_start = float(report_t[0]) - t

        return Seen(
            arrivals.zone[rows],
            arrivals.t[rows],
            arrivals.rate[rows],
            np.arange(len(rows)) < before,
            arrivals.label[rows],
            memory_start,
            self._reporting.is_alive(),
        )

    def _reported(self, zone: int) -> Floats:
        """Return the times (n,) of all arrivals as if by the clock of a zone's camera, seconds."""
        offsets = self._version.offset_of
        times: Floats = self.arrivals.t + (offsets[self.arrivals.zone] - offsets[zone])
        return times

    def _arrivals_before(self, zone: int, t: float, start: float) -> Rows:
        """Return the arrivals (rows) that may be of an object leaving at a zone.

        zone: index of the zone.
        t (seconds): corrected time of the exit.
        start (seconds): corrected time of the object's entry into the view; minus infinity if
            unknown.

        These are arrivals in other views, since the entry, and reported before the exit.
        """
        # Recent enough.
        times = self.arrivals.t
        [rows] = (times >= max(t + self._version.hazards.bins.lag_min, start)).nonzero()

        # At zones where objects may appear before they leave at ``zone``, and reported before the
        # exit.
        offsets = self._version.offset_of
        arrival_zones = self.arrivals.zone[rows]
        fits = self._version.hazards.seen_before(zone)[arrival_zones]
        fits &= times[rows] + (offsets[arrival_zones] - offsets[zone]) < t
        return rows[fits]

    def _is_open(self, row: int, t: float) -> bool:
        """Return True if the passage that began with an arrival had not ended before ``t``.

        row: row of the arrival.
        t (seconds): corrected time.

        It decides which of two passages that begin together was the earlier one: the one that ends
        first.
        """
        zone = int(self.arrivals.zone[row])
        start = float(self.arrivals.t[row])
        camera = self._version.zones[zone].camera
        return self.passages.was_in_view(
            camera, zone, start, t + self._version.clock_offset[camera]
        )

    # --- Observed events ---

    def _observe_entry(self, event: Event, zone: int, t: float) -> None:
        """Store an arrival with the rate of its possible causes, and the passage that begins."""
        label = self._version.labels.number(event.label)
        causes = self._causes(zone, t, label)
        rate = self._version.hazards.arrival_rate[zone] + sum(causes.values())
        self.arrivals.append(t, zone, label, rate)
        if event.track is None:
            return

        previous = max(causes, key=causes.__getitem__, default=None)
        sure = causes[previous] / rate if previous is not None else 0.0
        passage = Passage(t, event.camera, zone, previous, sure, label)
        exit_t = self.passages.begin(event.camera, str(event.track), event.t, passage)
        if exit_t is None:
            self._add_in_view(passage, np.flatnonzero(self.arrivals.t >= t))
        else:
            self._begin_late(passage, exit_t - self._version.clock_offset[event.camera])
        self.passages.forget_stale(t)

    def _observe_exit(self, event: Event, zone: int, t: float) -> None:
        """Store an exit, and add it to the possible causes of arrivals that were heard before it.

        zone, t: index of the zone, and corrected time, as of `_observe_entry`.
        """
        passage = None
        if event.track is not None:
            passage = self.passages.end(event.camera, str(event.track), event.t)
        entry_passage = passage or UNKNOWN
        label = self._version.labels.number(event.label, entry_passage.label)
        self.exits.append(t, zone, label, 0.0, entry_passage.t, entry_passage.entry)
        self._add_exit(zone, t, label, passage)

    def _begin_late(self, passage: Passage, exit_t: float) -> None:
        """Give an exit the passage that ended with it, as its entry is heard after it.

        exit_t (seconds): corrected time of the exit.
        """
        exits, camera_of = self.exits.after(exit_t), self._version.camera_of
        is_alone = (exits.t == exit_t) & (exits.entry == UNKNOWN.entry)
        is_alone &= camera_of[exits.zone] == camera_of[passage.entry]
        for row in np.flatnonzero(is_alone)[:1].tolist():
            zone, label = int(exits.zone[row]), int(exits.label[row])
            self._add_exit(zone, exit_t, label, None, -1.0)
            label = passage.label if label == UNKNOWN_LABEL else label
            exits.label[row], exits.entry_t[row], exits.entry[row] = label, passage.t, passage.entry
            self._add_in_view(passage, np.flatnonzero(self.arrivals.t >= passage.t))
            self._add_exit(zone, exit_t, label, passage)

    def _add_exit(
        self, zone: int, t: float, label: int, passage: Passage | None, factor: float = 1.0
    ) -> None:
        """Add the rates of an exit, times a factor, to arrivals that were heard before it.

        zone, t, label: index of the zone, corrected time (seconds) and label of the exit.
        passage: the passage that ends; None if unknown.

        The hazard of the exit takes the place of the rate of an object in view; after the exit, of
        all that follows from the entry, too.
        """
        arrivals, labels = self.arrivals, self._version.labels
        start = (passage or UNKNOWN).t
        rows_before = self._arrivals_before(zone, t, start)
        rows_after = np.flatnonzero((self._reported(zone) > t) & (arrivals.t >= start))
        rows = np.concatenate((rows_before, rows_after))
        targets = arrivals.zone[rows]
        rates = self._version.hazards.rates_from(zone, targets, arrivals.t[rows] - t)
        rates *= labels.agreement(label, arrivals.label[rows], targets)
        arrivals.rate[rows] += factor * rates
        if passage is not None:
            targets = arrivals.zone[rows_before]
            rates = self._version.hazards.rates_before_exit(passage.camera, targets)
            rates *= labels.agreement(passage.label, arrivals.label[rows_before], targets)
            arrivals.rate[rows_before] -= factor * rates
            self._add_in_view(passage, rows_after, -factor)

    def _add_in_view(self, passage: Passage, rows: Rows, factor: float = 1.0) -> None:
        """Add the rates of an object in view, times a factor, to arrivals in other views."""
        arrivals, camera_of = self.arrivals, self._version.camera_of
        since = arrivals.t[rows] - passage.t
        longest = self.passages.longest(passage.camera)
        is_other = camera_of[arrivals.zone[rows]] != camera_of[passage.entry]
        is_in_view = is_other & (since >= 0.0) & (since <= longest)
        rows, since = rows[is_in_view], since[is_in_view]
        if not len(rows):
            return
        hazards, targets = self._version.hazards, arrivals.zone[rows]
        rates = hazards.rates_before_exit(passage.camera, targets)
        rates += hazards.rates_entered(passage.entry, targets, since)
        agreement = self._version.labels.agreement(passage.label, arrivals.label[rows], targets)
        arrivals.rate[rows] += factor * rates * agreement

    def _causes(self, zone: int, t: float, label: int) -> dict[str, float]:
        """Return, by camera, the rate (1/s) at which objects known from it arrive at a zone.

        zone, t, label: index of the zone, corrected time and label of the arrival.

        These objects have left the camera's view, or are still in it. Objects from outside the site
        are not included.
        """
        # Objects that have left, if their passages began before.
        hazards, labels = self._version.hazards, self._version.labels
        cameras, camera_of = self._version.cameras, self._version.camera_of
        exits = self.exits.after(t - hazards.lag_max - self._version.offset_range)
        exit_row, _, rates = hazards.rates_by_row(exits.zone, zone, t - exits.t)
        rates = rates * labels.agreement(exits.label[exit_row], label, zone)
        rates *= exits.entry_t[exit_row] <= t
        total = np.bincount(camera_of[exits.zone[exit_row]], rates, minlength=len(cameras))
        causes = {cameras[k]: float(total[k]) for k in np.flatnonzero(total)}

        # What follows from the entries of those that left after the arrival, but were heard before.
        offsets = self._version.offset_of
        was_in_view = (exits.entry_t <= t) & (exits.entry >= 0)
        was_in_view &= t + (offsets[zone] - offsets[exits.zone]) < exits.t
        for row in np.flatnonzero(was_in_view).tolist():
            camera = cameras[camera_of[exits.zone[row]]]
            rate = hazards.rate_entered(exits.entry[row], zone, t - exits.entry_t[row])
            rate *= labels.of_two(exits.label[row], label, zone)
            causes[camera] = causes.get(camera, 0.0) + rate

        # Objects in other views that may appear at the zone before they leave.
        for camera in hazards.rates_before(zone):
            for passage in self.passages.open.of(camera).values():
                if rate := self._version.rate_in_view(passage, zone, t, label):
                    causes[camera] = causes.get(camera, 0.0) + rate
        return causes


class Reporting:
    """Counts events: a camera that is silent while the others have events is probably dead.

    cameras: names of the cameras that have zones.
    share (cameras,): share of each in all events of the site.

    events: number of observed events.
    """

    def __init__(self, cameras: list[str], share: Floats) -> None:
        self._cameras = cameras
        self._share = share
        self.events = 0
        self._last = np.zeros(len(cameras), np.int64)
        """(cameras,) number of each camera's last event in the order of all events."""

    def note(self, camera: int | None) -> None:
        """Note one event; ``camera`` is the number of its camera, None if it has no zone."""
        self.events += 1
        if camera is not None:
            self._last[camera] = self.events

    def is_alive(self) -> Floats:
        """Return the probability (cameras,) that each camera still reports, if it did at first.

        It is computed from the number of other cameras' events since the camera's last event.
        """
        nats = (self.events - self._last) * self._share
        dead = DEAD_PRIOR * np.expm1(np.minimum(nats, SILENCE_NATS_MAX))
        is_alive: Floats = 1.0 / (1.0 + dead)
        return is_alive

    def last_events(self) -> dict[str, int]:
        """Return the number of each camera's last event in the order of all events."""
        return dict(zip(self._cameras, self._last.tolist(), strict=True))

    def load(self, events: int, last_events: dict[str, int]) -> None:
        """Go on from earlier counts; a new camera counts as if it just had an event."""
        self.events = events
        self._last = np.array(
            [last_events.get(camera, events) for camera in self._cameras], np.int64
        )
