"""Predict where an object that has just left a zone appears next, and when.

A `Predictor` reads one topology version, observes events (`Predictor.observe`) and answers for an
exit (`Predictor.predict`). The possible outcomes of an exit compete: the object appears at one of
the zones after some lag, or leaves the site. Their prior odds are the learned hazards of all pairs
of zones. They are changed by the exit's *context* (`contexts`), by *exposure* (a lag of -L is only
possible if the passage has lasted L), by *seen arrivals* (where views overlap, the object may
already have appeared: `odds`), by *speed* (`time_windows`), and by *silent cameras*, which have
probably stopped reporting (`reporting`). If the question is asked again later, outcomes that would
have been observed by then have lost their odds.

Events have the times of their cameras' clocks. All times inside are *corrected times*: less the
clock offset of the camera, as given in the topology.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from camtopod.arrays import Rows
from camtopod.predict.anywhere import NEXT_PROBABILITY_MIN, Anywhere
from camtopod.predict.contexts import ContextMultipliers
from camtopod.predict.hand_over import HandOver, cameras_to_watch
from camtopod.predict.hazards import Hazards
from camtopod.predict.odds import ExitTable, Odds, Query, SeenArrivals, Site, find_odds
from camtopod.predict.open_passages import UNKNOWN, OpenPassages, Passage
from camtopod.predict.recent_events import (
    RECENT_MAX,
    RecentEvents,
    RecentState,
    moved_zones,
)
from camtopod.predict.reporting import Reporting
from camtopod.predict.time_windows import PaceModel
from camtopod.predict.zone_lookup import ZoneLookup
from camtopod.records import Event, NextCamera, Prediction, Topology, Zone
from camtopod.topology import LEAVE_FLOOR, block_of


class PredictorState(Struct):
    """The saved state of a `Predictor`: the observed events; the rest follows from its topology.

    arrivals, exits: the newest arrivals and exits.
    under_way: open passages, as (camera, track, passage).
    events: number of observed events.
    last_event: number of each camera's last event in the order of all events.

    Ended passages are left out: they only matter if a prediction is asked for again.
    """

    arrivals: RecentState
    exits: RecentState
    under_way: list[tuple[str, str, Passage]]
    events: int
    last_event: dict[str, int]


class Predictor:
    """Predicts by one topology version: give events to `observe`, and ask for exits with `predict`.

        >>> from camtopod import Event, Predictor, load_topology
        >>> predictor = Predictor(load_topology("topology.json"))
        >>> left = Event("lobby", "exit", 1_700_000_000.0)
        >>> likeliest = predictor.predict(left).candidates[0]
        >>> likeliest.zone, round(likeliest.q50)
        ('hall/1', 8)
        >>> predictor.observe(left)

    Ask for an exit before it is observed: otherwise the observed exit competes with the one that is
    asked for. This does not hold if `predict` is given the time of the question.
    """

    def __init__(self, topology: Topology) -> None:
        self.version = topology.version
        self.as_of = topology.as_of
        self.zones = topology.zones

        # Figures of the version, in a form for prediction.
        self._hazards = Hazards(topology)
        self.surroundings = ContextMultipliers(topology)
        self._paces = PaceModel(topology)
        self._hand_over = HandOver(topology)
        self._lookup = ZoneLookup(self.zones)
        self.site = Site(topology, self._hazards)
        self.anywhere = Anywhere(topology, self.site)
        deciles = self._hazards.stay
        longest = {
            camera: [deciles[zone][-1] for zone in zones if any(deciles[zone])]
            for camera, zones in self._lookup.of_camera.items()
        }
        self._longest_stay = {camera: max(stays) for camera, stays in longest.items() if stays}

        # Observed events.
        self.forget()

    @property
    def longest_lag(self) -> float:
        """Longest lag of the version, seconds: who is not seen by then has left."""
        return self._hazards.lag_max

    def forget(self) -> None:
        """Forget all observed events; needed when event time has been taken back."""
        self._open_passages = OpenPassages(self._longest_stay)
        self._arrivals, self._exits = RecentEvents(), RecentEvents()
        self._reporting = Reporting(self.site.cameras, self.site.event_share)

    def take_over(self, older: Predictor) -> None:
        """Take over the observed events from a predictor by an older version; this must be new."""
        moved = moved_zones(older.zones, self.zones)
        labels = self.site.labels.moved(older.site.labels)
        self._arrivals.take_over(older._arrivals, moved, labels)
        self._exits.take_over(older._exits, moved, labels)
        self._open_passages.take_over(older._open_passages, moved, labels)
        self._reporting.load(older._reporting.events, older._reporting.last_events())

    def save(self) -> PredictorState:
        """Return the state from which `load` continues, given the same topology."""
        return PredictorState(
            arrivals=self._arrivals.save(),
            exits=self._exits.save(),
            under_way=self._open_passages.passages(),
            events=self._reporting.events,
            last_event=self._reporting.last_events(),
        )

    def load(self, state: PredictorState) -> None:
        """Continue from a state saved with the same topology; this predictor must be new."""
        self._arrivals.load(state.arrivals)
        self._exits.load(state.exits)
        for camera, track, passage in state.under_way:
            self._open_passages.begin(camera, track, passage)
        self._reporting.load(state.events, state.last_event)

    def observe(self, event: Event) -> None:
        """Observe an event; events should be given in order of time as far as possible."""
        zone = self.zone_of(event)
        self._reporting.note(None if zone is None else int(self.site.camera_of[zone]))
        if zone is None:
            return
        t = event.t - self.site.clock_offset[event.camera]
        if event.kind == "entry":
            self._observe_entry(event, zone, t)
        else:
            self._observe_exit(event, zone, t)

    def zone_of(self, event: Event) -> int | None:
        """Return the zone (index) that an event belongs to; None if its camera has no zone."""
        return self._lookup.zone_of(event)

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

        Raise ValueError for a ``now`` before the exit.
        """
        _check(event.t, now)
        zone = self.zone_of(event)
        track = None if event.track is None else str(event.track)
        if zone is None:
            return Prediction(event.camera, None, event.t, track, self.version, 1.0, [])

        passages = self._open_passages
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
        here = self.zones[zone]
        table = self.site.table(zone)
        if table is None:
            leave, next_ = self.anywhere.shared_out(zone, 1.0, [], t, now)
            return self._prediction(here, t, track, leave, next_, passage)

        # Odds at the exit.
        known = passage or UNKNOWN
        corrected = t - self.site.clock_offset[here.camera]
        is_observed = now is not None and self._exits.has(corrected, zone)
        number = self.site.labels.number(label, known.label)
        query = Query(zone, corrected, passage, is_observed, label=number)
        odds = self._odds(query, table)

        # The context multiplies the odds. Odds that may be spurious count as leaving the site, from
        # the exit on.
        multiplier, leave = self.surroundings.multipliers(
            zone, table.outcomes, block, known.entry, known.previous, known.sure
        )
        spurious = table.outcomes.doubt
        leave += float(spurious @ (multiplier * odds.by_target()))

        # Odds at a later moment; their lag bins are those of the object's pace already.
        pace = self._paces.of_passage(known.entry, zone, query.dwell)
        if now is not None and now > t:
            slowness = 1.0 if pace is None else pace.factor
            odds = self._odds(query._replace(elapsed=now - t, slowness=slowness), table)
            leave = max(leave, LEAVE_FLOOR)
            pace = None

        # Probabilities of the outcomes that are likely enough.
        by_target = odds.by_target() * multiplier * (1.0 - spurious)
        chance, leave = table.outcomes.probabilities(by_target, leave)
        order = np.argsort(-chance, kind="stable")
        order = order[chance[order] >= NEXT_PROBABILITY_MIN]
        total = leave + float(chance[order].sum())
        probabilities = (chance[order] / total).tolist()

        next_ = [
            NextCamera(table.targets[k].camera, table.targets[k].id, probability, *window)
            for k, probability, window in zip(
                order.tolist(), probabilities, table.windows(order, odds, pace), strict=True
            )
        ]
        leave, next_ = self.anywhere.shared_out(zone, leave / total, next_, t, now)
        return self._prediction(here, t, track, leave, next_, passage if now is None else None)

    def _prediction(
        self,
        here: Zone,
        t: float,
        track: str | None,
        leave: float,
        next_: list[NextCamera],
        passage: Passage | None,
    ) -> Prediction:
        """Return the record of a prediction, with the hand-over if views overlap.

        here, t, track: zone, time and track of the exit.
        leave: probability that the object leaves the site.
        next_: the other outcomes.
        passage: the passage that ends with the exit; None to leave out the hand-over.
        """
        if passage is None or not self._hand_over.overlaps(here.camera):
            return Prediction(here.camera, here.id, t, track, self.version, leave, next_)
        offsets = self.site.clock_offset
        corrected = t - offsets[here.camera]
        in_view = self._hand_over.in_view(
            passage, corrected, self._open_passages, offsets, self.site.labels
        )
        looks = cameras_to_watch(in_view, next_)
        return Prediction(
            here.camera, here.id, t, track, self.version, leave, next_, looks, in_view
        )

    # --- The question ---

    def _odds(self, query: Query, table: ExitTable) -> Odds:
        """Return the odds of where and when the object of a query appears next."""
        is_alive = self._reporting.is_alive()[table.target_cameras]
        return find_odds(query, self.site, table, is_alive, self._seen_arrivals(query))

    def _seen_arrivals(self, query: Query) -> SeenArrivals:
        """Return the observed arrivals that may be of the object of a query.

        Two filters are used. Before the exit, arrivals count at zones where an object that leaves
        at the zone of the query may have appeared already, and since its entry into the view
        (`_arrivals_before`). Since the exit, arrivals at all zones count.
        """
        # Before the exit. An arrival at the very moment of the object's entry (tied) counts only if
        # its passage has not ended before the exit: of two passages that begin together, the one
        # that ends first counts as the earlier one (`_is_open`).
        arrivals = self._arrivals
        rows = self._arrivals_before(query.zone, query.t, query.began)
        tied = rows[arrivals.t[rows] == query.began]
        if len(tied):
            rows = np.setdiff1d(rows, [row for row in tied if not self._is_open(row, query.t)])
        before = len(rows)
        remembered = -math.inf

        # Since the exit, as far as they are reported by the moment of the question.
        if query.elapsed:
            offsets = self.site.offset_of
            reported = arrivals.t + (offsets[arrivals.zone] - offsets[query.zone])
            since = (reported >= query.t) & (reported <= query.t + query.elapsed)
            rows = np.concatenate((rows, np.flatnonzero(since)))
            if len(arrivals.t) == RECENT_MAX:  # older ones may have been forgotten
                remembered = float(reported[0]) - query.t

        is_before = np.arange(len(rows)) < before
        return SeenArrivals(
            arrivals.zone[rows],
            arrivals.t[rows],
            arrivals.rate[rows],
            is_before,
            arrivals.label[rows],
            remembered,
        )

    def _arrivals_before(self, zone: int, t: float, began: float) -> Rows:
        """Return the arrivals (rows) that may be of an object leaving at a zone.

        zone: index of the zone.
        t (seconds): corrected time of the exit.
        began (seconds): corrected time of the object's entry into the view; minus infinity if
            unknown.

        These are arrivals in other views, since the entry, and reported before the exit.
        """
        # Recent enough.
        times = self._arrivals.t
        [rows] = (times >= max(t + self._hazards.bins.lag_min, began)).nonzero()

        # At zones where objects may appear before they leave at ``zone``, and reported before the
        # exit.
        offsets = self.site.offset_of
        arrival_zones = self._arrivals.zone[rows]
        fits = self._hazards.seen_before(zone)[arrival_zones]
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
        began = float(self._arrivals.t[row])
        camera = self.zones[zone].camera
        return self._open_passages.was_in_view(
            camera, zone, began, t + self.site.clock_offset[camera]
        )

    # --- Observed events ---

    def _observe_entry(self, event: Event, zone: int, t: float) -> None:
        """Store an arrival with the rate of its possible causes, and the passage that begins."""
        label = self.site.labels.number(event.label)
        causes = self._causes(zone, t, label)
        rate = self._hazards.arrival_rate[zone] + sum(causes.values())
        self._arrivals.append(t, zone, label, rate)
        if event.track is None:
            return

        previous = max(causes, key=causes.__getitem__, default=None)
        sure = causes[previous] / rate if previous is not None else 0.0
        passage = Passage(t, event.camera, zone, previous, sure, label)
        self._open_passages.begin(event.camera, str(event.track), passage)
        self._add_simultaneous_cause(passage)
        self._open_passages.forget_stale(t)

    def _observe_exit(self, event: Event, zone: int, t: float) -> None:
        """Store an exit, and add it to the possible causes of arrivals before it.

        zone, t: index of the zone, and corrected time, as of `_observe_entry`.
        """
        passage = None
        if event.track is not None:
            passage = self._open_passages.end(event.camera, str(event.track), event.t)
        label = self.site.labels.number(event.label, (passage or UNKNOWN).label)
        self._exits.append(t, zone, label)

        # The hazard of the exit takes the place of the rate of an object in view.
        arrivals = self._arrivals
        rows = self._arrivals_before(zone, t, (passage or UNKNOWN).t)
        targets = arrivals.zone[rows]
        labels, came = self.site.labels, arrivals.label[rows]
        rates = self._hazards.rates_from(zone, targets, arrivals.t[rows] - t)
        arrivals.rate[rows] += rates * labels.agreement(label, came, targets)
        if passage is not None:
            rates = self._hazards.rates_before_exit(event.camera, targets)
            arrivals.rate[rows] -= rates * labels.agreement(passage.label, came, targets)

    def _add_simultaneous_cause(self, passage: Passage) -> None:
        """Add a passage that begins to the causes of arrivals in other views at the same time."""
        arrivals = self._arrivals
        hazards = self._hazards
        for row in range(len(arrivals.t) - 1, -1, -1):
            if arrivals.t[row] != passage.t:
                break
            target = int(arrivals.zone[row])
            if self.zones[target].camera != passage.camera:
                before_exit = hazards.rate_before_exit(passage.camera, target)
                rate = before_exit + hazards.rate_entered(passage.entry, target, 0.0)
                came = int(arrivals.label[row])
                arrivals.rate[row] += rate * self.site.labels.of_two(passage.label, came, target)

    def _causes(self, zone: int, t: float, label: int) -> dict[str, float]:
        """Return, by camera, the rate (1/s) at which objects known from it arrive at a zone.

        zone, t, label: index of the zone, corrected time and label of the arrival.

        These objects have left the camera's view, or are still in it. Objects from outside the site
        are not included.
        """
        # Objects that have left.
        hazards = self._hazards
        site = self.site
        exit_times, zones, left = self._exits.after(t - hazards.lag_max - site.offset_range)
        which, _, rates = hazards.rates_by_row(zones, zone, t - exit_times)
        rates = rates * site.labels.agreement(left[which], label, zone)
        total = np.bincount(site.camera_of[zones[which]], rates, minlength=len(site.cameras))
        causes = {site.cameras[k]: float(total[k]) for k in np.flatnonzero(total)}

        # Objects in other views that may appear at the zone before they leave.
        here = self.zones[zone].camera
        for camera in hazards.cameras_before.get(zone, []):
            if camera == here:
                continue
            before_exit = hazards.rate_before_exit(camera, zone)
            for passage in self._open_passages.in_view(camera):
                rate = before_exit + hazards.rate_entered(passage.entry, zone, t - passage.t)
                rate *= site.labels.of_two(passage.label, label, zone)
                if rate:
                    causes[camera] = causes.get(camera, 0.0) + rate
        return causes


def _check(t: float, now: float | None) -> None:
    """Raise ValueError for a question before the exit."""
    if now is not None and not t <= now < math.inf:
        raise ValueError(
            f"now is {now}: give the time of the exit, {t}, or a later one, in seconds"
        )
