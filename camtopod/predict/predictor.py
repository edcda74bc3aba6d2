"""Predict where an object that has just left a zone appears next, and when.

A `Predictor` reads one topology version, observes events (`Predictor.observe`) and answers for an
exit (`Predictor.predict`): the `outlook` of the exit, with what has been observed.

Events have the times of their cameras' clocks. All times inside are *corrected times*: less the
clock offset of the camera, as given in the topology.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from camtopod.arrays import Floats, Rows
from camtopod.codec import require_event
from camtopod.predict.hand_over import cameras_to_watch
from camtopod.predict.outlook import Departure, Outlook, Seen, outlook
from camtopod.predict.passages import UNKNOWN, Passage, RecentPassages
from camtopod.predict.recent_events import (
    RECENT_MAX,
    RecentEvents,
    RecentState,
    moved_zones,
)
from camtopod.predict.reporting import Reporting
from camtopod.predict.time_windows import TIMED_TRANSITIONS_MIN, WINDOW
from camtopod.predict.version import PreparedVersion
from camtopod.records import Event, NextCamera, Prediction, Topology
from camtopod.topology import block_of


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


class Predictor:
    """Predicts by one topology version: give events to `observe`, and ask for exits with `predict`.

        >>> from camtopod import Event, Predictor, load_topology
        >>> predictor = Predictor(load_topology("topology.json"))
        >>> left = Event("lobby", "exit", 1_700_000_000.0)
        >>> likeliest = predictor.predict(left).next[0]
        >>> likeliest.zone, round(likeliest.q50)
        ('hall/1', 8)
        >>> predictor.observe(left)

    Ask for an exit before it is observed: otherwise the observed exit competes with the one that is
    asked for. This does not hold if `predict` is given the time of the question.
    """

    def __init__(self, topology: Topology, prepared: PreparedVersion | None = None) -> None:
        """Begin without events; ``prepared`` is the same topology, if it is prepared already."""
        self.prepared = prepared or PreparedVersion(topology)
        self.version = self.prepared.number
        self.zones = self.prepared.zones
        self.forget()

    def forget(self) -> None:
        """Forget all observed events; needed when event time has been taken back."""
        self._passages = RecentPassages(self.prepared.longest_stays())
        self._arrivals, self._exits = RecentEvents(), RecentEvents()
        self._reporting = Reporting(self.prepared.cameras, self.prepared.event_share)
        self._since = math.inf

    def take_over(self, older: Predictor) -> None:
        """Take over the observed events from a predictor by an older version; this must be new."""
        new_zones = moved_zones(older.zones, self.zones)
        labels = self.prepared.labels.moved(older.prepared.labels)
        self._arrivals.take_over(older._arrivals, new_zones, labels)
        self._exits.take_over(older._exits, new_zones, labels)
        self._passages.take_over(older._passages, new_zones, labels)
        self._reporting.load(older._reporting.events, older._reporting.last_events())
        self._since = older._since

    def save(self) -> PredictorState:
        """Return the state from which `load` continues, given the same topology."""
        return PredictorState(
            arrivals=self._arrivals.save(),
            exits=self._exits.save(),
            under_way=[(*key, passage) for key, passage in self._passages.open.passages()],
            events=self._reporting.events,
            last_event=self._reporting.last_events(),
            since=self._since,
        )

    def load(self, state: PredictorState) -> None:
        """Continue from a state saved with the same topology; this predictor must be new."""
        self._arrivals.load(state.arrivals)
        self._exits.load(state.exits)
        for camera, track, passage in state.under_way:
            self._passages.open.begin(camera, track, passage)
        self._reporting.load(state.events, state.last_event)
        self._since = state.since

    def observe(self, event: Event) -> None:
        """Observe an event; events should be given in order of time as far as possible.

        Raise ValueError for an event that is neither entry nor exit, or without a time.
        """
        require_event(event)
        zone = self.zone_of(event)
        self._reporting.note(None if zone is None else int(self.prepared.camera_of[zone]))
        if zone is None:
            return
        t = event.t - self.prepared.clock_offset[event.camera]
        self._since = min(self._since, t)
        if event.kind == "entry":
            self._observe_entry(event, zone, t)
        else:
            self._observe_exit(event, zone, t)

    def zone_of(self, event: Event) -> int | None:
        """Return the zone (index) that an event belongs to; None if its camera has no zone."""
        return self.prepared.zone_of(event)

    def zone_id_of(self, event: Event) -> str | None:
        """Return the id of the zone that an event belongs to; None if its camera has no zone."""
        zone = self.zone_of(event)
        return None if zone is None else self.zones[zone].id

    def predict(self, event: Event, now: float | None = None) -> Prediction:
        """Return the prediction where and when the object of an exit appears next.

        event: the exit.
        now (seconds by the camera's clock): moment of the question; None for the moment of the
            exit. Later, the exit may have been observed, too, and windows may lie before ``now``
            where an arrival may have been that of the object.

        Raise `UnknownPlace` (a KeyError) for a camera that the version does not have, ValueError
        for an event that is no exit, or a ``now`` before it.
        """
        require_event(event, "exit")
        self.prepared.require_camera(event.camera)
        return self.answer(event, now)

    def answer(self, event: Event, now: float | None = None) -> Prediction:
        """Return what `predict` does; of a camera that is new since the version, nothing is known.

        event: an exit.
        """
        zone = self.zone_of(event)
        track = None if event.track is None else str(event.track)
        if zone is None:
            _check(event.t, now)
            return Prediction(event.camera, None, event.t, track, self.version, 1.0, [], prior=True)

        passages = self._passages
        passage = None if track is None else passages.left_at(event.camera, track, event.t)
        block = block_of(event.x, event.y)
        return self.predict_from(zone, event.t, passage, track, block, now, event.label)

    def predict_from(
        self,
        zone: int,
        t: float,
        passage: Passage | None = None,
        track: str | None = None,
        block: int | None = None,
        now: float | None = None,
        label: str | None = None,
    ) -> Prediction:
        """Return the prediction for an exit whose zone is known; see `predict`.

        zone: index of the zone of the exit.
        t (seconds by the clock of the zone's camera): time of the exit.
        passage: the passage that ends with the exit; None if unknown.
        track: track of the exit, for the record only.
        block: block of the image where the object left (`camtopod.topology.block_of`); None if
            unknown.
        now: as for `predict`.
        label: class of the object; None for that of its entry.
        """
        _check(t, now)
        entry_passage = passage or UNKNOWN
        site_t = t - self.prepared.offset_of[zone]
        departure = Departure(
            zone,
            site_t,
            passage,
            block,
            self.prepared.labels.number(label, entry_passage.label),
            is_observed=now is not None and self._exits.has(site_t, zone),
            elapsed=0.0 if now is None else now - t,
        )
        answer = outlook(self.prepared, departure, self._seen(departure))
        next_cameras = self._following(answer)
        exit_zone = self.zones[zone]
        prediction = Prediction(
            *(exit_zone.camera, exit_zone.id, t, track, self.version, answer.leave, next_cameras),
            prior=not self.prepared.is_learned(zone),
        )
        if (
            passage is None
            or now is not None
            or not self.prepared.hand_over.overlaps(exit_zone.camera)
        ):
            return prediction

        # The hand-over, where views overlap.
        in_view = self.prepared.hand_over.in_view(
            passage,
            site_t,
            self._passages,
            self.prepared.clock_offset,
            self.prepared.labels,
        )
        return replace(prediction, look=cameras_to_watch(in_view, next_cameras), in_view=in_view)

    def _following(self, answer: Outlook) -> list[NextCamera]:
        """Return the next appearances by an outlook, likeliest first.

        There is a row for each that links tell, and one for each camera where it may be anywhere.
        """
        cameras = np.flatnonzero(answer.elsewhere)
        zones = self.prepared.anywhere.busiest[cameras]
        probability = answer.elsewhere[cameras]
        windows = self._windows_anywhere(answer, zones)
        is_guess = np.ones(len(zones), np.bool_)
        if answer.table is not None:
            rows = np.flatnonzero(answer.chance)
            zones = np.append(answer.table.outcomes.targets[rows], zones)
            probability = np.append(answer.chance[rows], probability)
            windows = np.concatenate((answer.windows(rows), windows))
            is_guess = np.append(answer.table.transitions[rows] < TIMED_TRANSITIONS_MIN, is_guess)

        order = np.argsort(-probability, kind="stable")
        camera, zone_id = (names[zones] for names in self.prepared.zone_names)
        columns = (camera, zone_id, probability, *np.round(windows, 3).T, is_guess)
        return list(map(NextCamera, *(column[order].tolist() for column in columns)))

    def _windows_anywhere(self, answer: Outlook, zones: Rows) -> Floats:
        """Return the time windows (zones, 3, seconds) of appearing after no particular lag."""
        first, last = answer.span
        lags = np.tile(first + np.array(WINDOW) * (last - first), (len(zones), 1))
        if not self.prepared.is_corrected:
            offset = self.prepared.offset_of
            lags += (offset[zones] - offset[answer.departure.zone])[:, None]
        return lags

    # --- The question ---

    def _seen(self, departure: Departure) -> Seen:
        """Return what has been observed by the moment of a question.

        Two filters are used. Before the exit, arrivals count at zones where an object that leaves
        at the zone of the exit may have appeared already (`_arrivals_before`). Since the exit,
        arrivals at all zones count. An arrival before the object's entry into the view never does.
        """
        # Before the exit. An arrival at the very moment of the object's entry (tied) counts only if
        # its passage has not ended before the exit: of two passages that begin together, the one
        # that ends first counts as the earlier one (`_is_open`).
        arrivals, zone, t = self._arrivals, departure.zone, departure.t
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
        offsets = self.prepared.offset_of
        times: Floats = self._arrivals.t + (offsets[self._arrivals.zone] - offsets[zone])
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
        times = self._arrivals.t
        [rows] = (times >= max(t + self.prepared.hazards.bins.lag_min, start)).nonzero()

        # At zones where objects may appear before they leave at ``zone``, and reported before the
        # exit.
        offsets = self.prepared.offset_of
        arrival_zones = self._arrivals.zone[rows]
        fits = self.prepared.hazards.seen_before(zone)[arrival_zones]
        fits &= times[rows] + (offsets[arrival_zones] - offsets[zone]) < t
        return rows[fits]

    def _is_open(self, row: int, t: float) -> bool:
        """Return True if the passage that began with an arrival had not ended before ``t``.

        row: row of the arrival.
        t (seconds): corrected time.

        It decides which of two passages that begin together was the earlier one: the one that ends
        first.
        """
        zone = int(self._arrivals.zone[row])
        start = float(self._arrivals.t[row])
        camera = self.zones[zone].camera
        return self._passages.was_in_view(
            camera, zone, start, t + self.prepared.clock_offset[camera]
        )

    # --- Observed events ---

    def _observe_entry(self, event: Event, zone: int, t: float) -> None:
        """Store an arrival with the rate of its possible causes, and the passage that begins."""
        label = self.prepared.labels.number(event.label)
        causes = self._causes(zone, t, label)
        rate = self.prepared.hazards.arrival_rate[zone] + sum(causes.values())
        self._arrivals.append(t, zone, label, rate)
        if event.track is None:
            return

        previous = max(causes, key=causes.__getitem__, default=None)
        sure = causes[previous] / rate if previous is not None else 0.0
        passage = Passage(t, event.camera, zone, previous, sure, label)
        if self._passages.begin(event.camera, str(event.track), event.t, passage):
            self._add_in_view(passage, np.flatnonzero(self._arrivals.t >= t))
        self._passages.forget_stale(t)

    def _observe_exit(self, event: Event, zone: int, t: float) -> None:
        """Store an exit, and add it to the possible causes of arrivals that were heard before it.

        zone, t: index of the zone, and corrected time, as of `_observe_entry`.
        """
        passage = None
        if event.track is not None:
            passage = self._passages.end(event.camera, str(event.track), event.t)
        entry_passage = passage or UNKNOWN
        label = self.prepared.labels.number(event.label, entry_passage.label)
        self._exits.append(t, zone, label, 0.0, entry_passage.t, entry_passage.entry)

        # The hazard of the exit takes the place of the rate of an object in view; after the exit,
        # of all that follows from the entry, too.
        arrivals, labels = self._arrivals, self.prepared.labels
        rows_before = self._arrivals_before(zone, t, entry_passage.t)
        is_after = (self._reported(zone) > t) & (arrivals.t >= entry_passage.t)
        rows_after = np.flatnonzero(is_after)
        rows = np.concatenate((rows_before, rows_after))
        targets = arrivals.zone[rows]
        rates = self.prepared.hazards.rates_from(zone, targets, arrivals.t[rows] - t)
        arrivals.rate[rows] += rates * labels.agreement(label, arrivals.label[rows], targets)
        if passage is not None:
            targets = arrivals.zone[rows_before]
            rates = self.prepared.hazards.rates_before_exit(event.camera, targets)
            rates *= labels.agreement(passage.label, arrivals.label[rows_before], targets)
            arrivals.rate[rows_before] -= rates
            self._add_in_view(passage, rows_after, -1.0)

    def _add_in_view(self, passage: Passage, rows: Rows, factor: float = 1.0) -> None:
        """Add the rates of an object in view, times a factor, to arrivals in other views."""
        arrivals, camera_of = self._arrivals, self.prepared.camera_of
        since = arrivals.t[rows] - passage.t
        longest = self._passages.longest(passage.camera)
        is_other = camera_of[arrivals.zone[rows]] != camera_of[passage.entry]
        is_in_view = is_other & (since >= 0.0) & (since <= longest)
        rows, since = rows[is_in_view], since[is_in_view]
        if not len(rows):
            return
        hazards, targets = self.prepared.hazards, arrivals.zone[rows]
        rates = hazards.rates_before_exit(passage.camera, targets)
        rates += hazards.rates_entered(passage.entry, targets, since)
        agreement = self.prepared.labels.agreement(passage.label, arrivals.label[rows], targets)
        arrivals.rate[rows] += factor * rates * agreement

    def _causes(self, zone: int, t: float, label: int) -> dict[str, float]:
        """Return, by camera, the rate (1/s) at which objects known from it arrive at a zone.

        zone, t, label: index of the zone, corrected time and label of the arrival.

        These objects have left the camera's view, or are still in it. Objects from outside the site
        are not included.
        """
        # Objects that have left, if their passages began before.
        hazards, labels = self.prepared.hazards, self.prepared.labels
        cameras, camera_of = self.prepared.cameras, self.prepared.camera_of
        exits = self._exits.after(t - hazards.lag_max - self.prepared.offset_range)
        exit_row, _, rates = hazards.rates_by_row(exits.zone, zone, t - exits.t)
        rates = rates * labels.agreement(exits.label[exit_row], label, zone)
        rates *= exits.entry_t[exit_row] <= t
        total = np.bincount(camera_of[exits.zone[exit_row]], rates, minlength=len(cameras))
        causes = {cameras[k]: float(total[k]) for k in np.flatnonzero(total)}

        # What follows from the entries of those that left after the arrival, but were heard before.
        offsets = self.prepared.offset_of
        was_in_view = (exits.entry_t <= t) & (exits.entry >= 0)
        was_in_view &= t + (offsets[zone] - offsets[exits.zone]) < exits.t
        for row in np.flatnonzero(was_in_view).tolist():
            camera = cameras[camera_of[exits.zone[row]]]
            rate = hazards.rate_entered(exits.entry[row], zone, t - exits.entry_t[row])
            rate *= labels.of_two(exits.label[row], label, zone)
            causes[camera] = causes.get(camera, 0.0) + rate

        # Objects in other views that may appear at the zone before they leave.
        for camera in hazards.rates_before(zone):
            for passage in self._passages.open.of(camera).values():
                if rate := self.prepared.rate_in_view(passage, zone, t, label):
                    causes[camera] = causes.get(camera, 0.0) + rate
        return causes


def _check(t: float, now: float | None) -> None:
    """Raise ValueError for a question before the exit."""
    if now is not None and not t <= now < math.inf:
        raise ValueError(
            f"now is {now}: give the time of the exit, {t}, or a later one, in seconds"
        )
