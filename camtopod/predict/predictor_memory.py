"""The memory of a predictor: the arrivals, exits and passages that it has observed, by one version.

Only events are stored. What an arrival's causes are, the objects that have left other views and
those that are still in them, is computed when it is asked for, so that the order in which events
are heard does not matter. `Reporting` has which cameras still report.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from camtopod.arrays import Floats, Ints, Rows
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

        # That the object may have caused; after the exit, this depends on its pace.
        hazards, passage = self._version.hazards, departure.passage or UNKNOWN
        is_before = np.arange(len(rows)) < before
        if before:
            zones, times = arrivals.zone[rows], arrivals.t[rows]
            own_rate = hazards.rates_from(zone, zones, times - t)
            own_rate += hazards.rates_entered(passage.entry, zones, times - passage.t)
            fits = (own_rate > 0.0) | ~is_before
            rows, is_before = rows[fits], is_before[fits]

        # The causes of these, and of the object's own entry.
        own_entry = [] if departure.passage is None else [passage]
        zones = np.append(arrivals.zone[rows], np.array([p.entry for p in own_entry], np.int32))
        times = np.append(arrivals.t[rows], [p.t for p in own_entry])
        labels = np.append(arrivals.label[rows], np.array([p.label for p in own_entry], np.int32))
        causes = self._causes(zones, times, labels, departure)
        rates = causes.sum(axis=0) + hazards.arrival_rate[zones]
        previous, sure = None, 0.0
        if own_entry and causes[:, -1].any():
            likeliest = int(causes[:, -1].argmax())
            previous = self._version.cameras[likeliest]
            sure = float(causes[likeliest, -1] / rates[-1])
        arrival = slice(len(rows))
        return Seen(
            *(zones[arrival], times[arrival], labels[arrival], rates[arrival], is_before),
            *(memory_start, self._reporting.is_alive(), previous, sure),
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
        zone, start = int(self.arrivals.zone[row]), float(self.arrivals.t[row])
        exits = self.exits.after(t)
        if ((exits.entry_t == start) & (exits.entry == zone)).any():
            return True
        open_passages = self.passages.open.of(self._version.zones[zone].camera).values()
        return any(passage.t == start and passage.entry == zone for passage in open_passages)

    # --- Observed events ---

    def _observe_entry(self, event: Event, zone: int, t: float) -> None:
        """Store an arrival, and the passage that begins."""
        label = self._version.labels.number(event.label)
        self.arrivals.append(t, zone, label)
        if event.track is None:
            return

        passage = Passage(t, event.camera, zone, label)
        exit_t = self.passages.begin(event.camera, str(event.track), event.t, passage)
        if exit_t is not None:
            self._begin_late(passage, exit_t - self._version.clock_offset[event.camera])
        self.passages.forget_stale(t)

    def _observe_exit(self, event: Event, zone: int, t: float) -> None:
        """Store an exit, with the passage that ends.

        zone, t: index of the zone, and corrected time, as of `_observe_entry`.
        """
        passage = UNKNOWN
        if event.track is not None:
            passage = self.passages.end(event.camera, str(event.track), event.t) or UNKNOWN
        label = self._version.labels.number(event.label, passage.label)
        self.exits.append(t, zone, label, passage.t, passage.entry)

    def _begin_late(self, passage: Passage, exit_t: float) -> None:
        """Give an exit the passage that ended with it, as its entry is heard after it.

        exit_t (seconds): corrected time of the exit.
        """
        exits, camera_of = self.exits.after(exit_t), self._version.camera_of
        is_alone = (exits.t == exit_t) & (exits.entry == UNKNOWN.entry)
        is_alone &= camera_of[exits.zone] == camera_of[passage.entry]
        for row in np.flatnonzero(is_alone)[:1].tolist():
            exits.entry_t[row], exits.entry[row] = passage.t, passage.entry
            if exits.label[row] == UNKNOWN_LABEL:
                exits.label[row] = passage.label

    # --- Causes of an arrival ---

    def _causes(
        self, zone: Ints, t: Floats, label: Ints, without: Departure | None = None
    ) -> Floats:
        """Return the rates (cameras, n, 1/s) at which objects known from each arrive at zones.

        zone, t, label (n,): index of the zone, corrected time (seconds) and label of each arrival.
        without: departure of an object that does not count.

        These objects have left the camera's view, or are still in it. Objects from outside the site
        are not included.
        """
        version, hazards, labels = self._version, self._version.hazards, self._version.labels
        causes = np.zeros((len(version.cameras), len(zone)))
        if not len(zone):
            return causes

        # Objects that have left, if their passages began before.
        offsets, first_t = version.offset_of, float(t.min()) - version.offset_range
        exits = self.exits.after(first_t - hazards.lag_max)
        is_cause = hazards.is_source(zone).take(exits.zone)
        if without is not None:
            is_own = (exits.t == without.t) & (exits.zone == without.zone)
            is_own &= exits.entry_t == without.began
            is_own[np.flatnonzero(is_own)[1:]] = False
            is_cause &= ~is_own
        [row] = is_cause.nonzero()
        source = exits.zone[row]
        rates = hazards.rates_from(source[:, None], zone, t - exits.t[row, None])
        rates *= labels.agreement(exits.label[row, None], label, zone)
        rates *= exits.entry_t[row, None] <= t
        np.add.at(causes, version.camera_of[source], rates)

        # What follows from the entries of those that left after the arrival. Before they leave,
        # objects of some other cameras may appear.
        cameras = hazards.cameras_before(zone)
        if not cameras:
            return causes
        later = slice(int(exits.t.searchsorted(first_t, "right")), None)
        source, entry = exits.zone[later], exits.entry[later]
        is_before = np.zeros(len(version.cameras), np.bool_)
        is_before[cameras] = True
        counts = (entry >= 0) & is_before[version.camera_of[source]]
        if without is not None:
            counts &= ~is_own[later]
        [row] = counts.nonzero()
        source, entry = source[row], entry[row]
        row += later.start
        rates = hazards.rates_entered(entry[:, None], zone, t - exits.entry_t[row, None])
        rates *= labels.agreement(exits.label[row, None], label, zone)
        rates *= t + offsets[zone] < (exits.t[row] + offsets[source])[:, None]
        np.add.at(causes, version.camera_of[source], rates)

        # The same for those that are still in view.
        own_passage = None if without is None else without.passage
        open_passages = [
            passage
            for camera in cameras
            for passage in self.passages.open.of(version.cameras[camera]).values()
            if passage is not own_passage
        ]
        if open_passages:
            rates = version.rates_in_view(open_passages, zone, t, label)
            start = np.array([passage.t for passage in open_passages])
            longest = [self.passages.longest(passage.camera) for passage in open_passages]
            rates *= t - start[:, None] <= np.array(longest)[:, None]
            np.add.at(causes, version.camera_of[[p.entry for p in open_passages]], rates)
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
