"""Where an object that has just left will appear next: competing outcomes, weighed by what has been seen since.

For an exit at zone u the outcomes are: appearing at each zone v with a lag, or not being seen again. Their prior odds
are the learned hazards, all of them, weak evidence included. Five things are then known at the time of the exit:

* *context*: where the object came in, where exactly it left, from which camera it probably came before;
* *exposure*: a lag of -L is only possible if this passage has lasted L;
* *seen*: where views overlap the object may already have appeared; each recent arrival counts for its hazard over the
  rate of everything else that could have caused it, and an overlapped view without an arrival loses its share;
* *pace*: who was slow in this view takes longer to the next;
* *alive*: a camera silent for far longer than its traffic allows is not where objects will be seen.

Asked again later, what would have shown by then has lost its odds to the rest, and each arrival since the exit counts
as those before it do; both by the object's pace. Windows are those of the odds that remain.

Events come with their cameras' own clocks; inside, times are right ones, as far as the topology knows the clocks.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.learn.hazards import Hazards, Outcomes
from camtopod.learn.joint import LEAVE_FLOOR
from camtopod.learn.lag_odds import paced, quantiles, unknown
from camtopod.learn.pace import Paces
from camtopod.learn.positions import block_of
from camtopod.learn.recent import RECENT_MAX, Arrival, Recent
from camtopod.learn.settings import GRID_COLUMNS, GRID_ROWS
from camtopod.learn.surroundings import Surroundings
from camtopod.learn.under_way import Passage, UnderWay
from camtopod.records import Event, NextCamera, Prediction, Topology, Zone

Floats = NDArray[np.float64]

DEAD_PRIOR = 1e-3
"""Prior probability that a camera has gone silent for good."""
SILENCE_NATS_MAX = 50.0
NEXT_PROBABILITY_MIN = 1e-4
"""Outcomes less likely than this are left out."""
RATE_MIN = 1e-6


class PredictorState(Struct):
    """What a `Predictor` has observed; what it knows beside that is its topology.

    Passages that have ended are left out: they only matter to who asks again about an exit.
    """

    arrivals: list[Arrival]
    exit_times: Floats
    exit_zones: NDArray[np.int32]
    under_way: list[tuple[str, str, Passage]]
    events: int
    last_event: dict[str, int]


class Predictor:
    """Prediction over one topology version. `observe` keeps it abreast of events; `predict` answers for an exit.

    An exit is to be predicted before it is observed, else it competes with itself; not so where `predict` is told when
    it is asked.
    """

    def __init__(self, topology: Topology) -> None:
        self.topology = topology
        self.zones = topology.zones
        self._hazards = Hazards(topology)
        self._surroundings = Surroundings(topology)
        self._paces = Paces(topology)
        self._of_camera: dict[str, list[int]] = {}
        for k, zone in enumerate(self.zones):
            self._of_camera.setdefault(zone.camera, []).append(k)
        self._ahead = {camera.id: camera.clock_offset for camera in topology.cameras}
        self._clocks_apart = max(self._ahead.values(), default=0.0) - min(self._ahead.values(), default=0.0)
        self._corrected = topology.model is not None and topology.model.clocks_corrected
        self._share = {known.camera: known.share for known in (topology.model.cameras if topology.model else [])}
        stay_max = {camera: self._hazards.longest_stay(zones) for camera, zones in self._of_camera.items()}
        self._under_way = UnderWay({camera: stay for camera, stay in stay_max.items() if stay})
        self._arrivals, self._exits = Recent(), Recent()
        self._ahead_of = np.array([self._ahead.get(zone.camera, 0.0) for zone in self.zones])
        self._wanted = np.zeros(len(self.zones), np.bool_)  # all False between calls
        self._row_of = np.full(len(self.zones), -1, np.intp)  # all -1 between calls
        self._names = list(self._of_camera)
        number = {camera: k for k, camera in enumerate(self._names)}
        self._camera_of = np.array([number[zone.camera] for zone in self.zones], np.int32)
        self._events = 0
        self._last_event = dict.fromkeys(self._of_camera, 0)

    def follow(self, topology: Topology) -> Predictor:
        """A predictor over a newer version that remembers what this one has observed."""
        newer = Predictor(topology)
        newer.take_over(self)
        return newer

    def take_over(self, older: Predictor) -> None:
        """Remember what one over an older version has observed; this one must be new."""
        index = {zone.id: k for k, zone in enumerate(self.zones)}
        moved = {k: index[zone.id] for k, zone in enumerate(older.zones) if zone.id in index}
        for arrival in older._arrivals.arrivals():
            if arrival.zone in moved:
                self._arrivals.append(arrival.t, moved[arrival.zone], arrival.rate)
        for t, zone in zip(*(column.tolist() for column in older._exits.after(-math.inf)), strict=True):
            if zone in moved:
                self._exits.append(t, moved[zone])
        self._under_way.take_over(older._under_way, moved)
        self._events = older._events
        self._last_event = {camera: older._last_event.get(camera, older._events) for camera in self._of_camera}

    def save(self) -> PredictorState:
        """Everything `load` needs, beside the topology, to go on from here."""
        under_way, exits = self._under_way.passages(), self._exits.save()
        return PredictorState(self._arrivals.arrivals(), *exits, under_way, self._events, self._last_event)

    def load(self, state: PredictorState) -> None:
        """Go on from there, over the same topology."""
        for arrival in state.arrivals:
            self._arrivals.append(arrival.t, arrival.zone, arrival.rate)
        self._exits.load(state.exit_times, state.exit_zones)
        for camera, track, passage in state.under_way:
            self._under_way.begin(camera, track, passage)
        self._events, self._last_event = state.events, state.last_event

    def observe(self, event: Event) -> None:
        """Take note of an event; they must come by time as far as that is possible."""
        self._events += 1
        zone = self.zone_of(event)
        if zone is None:
            return
        self._last_event[event.camera] = self._events
        t = event.t - self._ahead[event.camera]
        if event.kind == "entry":
            causes = self._causes(zone, t)
            rate = self._hazards.arrival_rate[zone] + sum(causes.values())
            self._arrivals.append(t, zone, rate)
            if event.track is not None:
                previous = max(causes, key=lambda camera: causes[camera], default=None)
                sure = causes[previous] / rate if previous is not None else 0.0
                passage = Passage(t, event.camera, zone, previous, sure)
                self._under_way.begin(event.camera, str(event.track), passage)
                self._under_way.forget_stale(t)
            return
        left = None if event.track is None else self._under_way.end(event.camera, str(event.track), event.t)
        since = left.t if left else -math.inf
        self._exits.append(t, zone)
        found = self._recent(t, since, zone)
        there = self._arrivals.zone[found]
        more = self._hazards.rates_from(zone, there, self._arrivals.t[found] - t)
        self._arrivals.rate[found] += more - self._hazards.rates_ahead(event.camera, there) if left else more

    def zone_of(self, event: Event) -> int | None:
        """Index of the zone the event most likely belongs to; None for a camera without zones."""
        candidates = self._of_camera.get(event.camera)
        if not candidates:
            return None
        if event.x is None or event.y is None:
            return max(candidates, key=lambda k: self.zones[k].entries + self.zones[k].exits)
        x, y = event.x, event.y
        return max(candidates, key=lambda k: _log_density(self.zones[k], x, y))

    def predict(self, event: Event, now: float | None = None) -> Prediction:
        """Next appearance of the object of an exit, by what is known at the exit.

        Or, asked again, by what is known at ``now``, seconds by the same camera's clock. The exit may have been
        observed since. Where an arrival may have been the object's, the window may lie before ``now``. Raises
        ValueError for a ``now`` before the exit.
        """
        _check(event.t, now)
        zone = self.zone_of(event)
        track = None if event.track is None else str(event.track)
        if zone is None:
            return Prediction(event.camera, None, event.t, track, self.topology.version, 1.0, [])
        passage = None
        if track is not None and now is None:
            passage = self._under_way.get(event.camera, track)
        elif track is not None:
            passage = self._under_way.left_at(event.camera, track, event.t)
        return self.predict_from(zone, event.t, passage, track, block_of(event.x, event.y), now)

    def predict_from(
        self,
        zone: int,
        t: float,
        passage: Passage | None = None,
        track: str | None = None,
        block: int | None = None,
        now: float | None = None,
    ) -> Prediction:
        """The same for an object that left a zone (index) at ``t`` by the clock of the zone's camera, after a passage
        and in a block of the image, if known.
        """
        _check(t, now)
        here, outcomes = self.zones[zone], self._hazards.outcomes.get(zone)
        if outcomes is None:
            return Prediction(here.camera, here.id, t, track, self.topology.version, 1.0, [])
        left, edges = t - self._ahead[here.camera], self._hazards.bins.edges
        stay = None if passage is None else left - passage.t
        entry, departures = None if passage is None else passage.entry, self._hazards.departures[zone]
        pace = self._paces.of_passage(entry, zone, stay)
        observed = now is not None and self._has_left(zone, left)
        mass = self._odds(zone, outcomes, left, passage, observed)
        known = (None, None, 0.0) if passage is None else (passage.entry, passage.previous, passage.sure)
        likelier, leave = self._surroundings.multipliers(zone, outcomes, block, *known)
        mass *= likelier[:, None]
        odds = mass.sum(axis=1)
        leave += float((outcomes.doubt * odds).sum())
        if now is not None and now > t:  # what may as well be chance was so at the exit: it is gone, seen or not
            slower, pace = 1.0 if pace is None else pace[0], None
            mass = self._odds(zone, outcomes, left, passage, observed, now - t, slower) * likelier[:, None]
            edges, odds, leave = paced(edges, slower), mass.sum(axis=1), max(leave, LEAVE_FLOOR)
        odds *= 1.0 - outcomes.doubt
        total = leave + float(odds.sum())
        order = [int(k) for k in np.argsort(-odds, kind="stable") if odds[k] >= NEXT_PROBABILITY_MIN * total]
        kept = leave + float(odds[order].sum())
        following = []
        chances, rests_on = (odds[order] / kept).tolist(), (outcomes.share[order] * departures).tolist()
        usual = quantiles(mass[order], edges)
        for k, chance, transitions, lags in zip(order, chances, rests_on, usual, strict=True):
            target = self.zones[outcomes.targets[k]]
            q10, q50, q90 = self._paces.at_pace(pace, transitions, *lags)
            shift = 0.0 if self._corrected else self._ahead[target.camera] - self._ahead[here.camera]
            times = round(q10 + shift, 3), round(q50 + shift, 3), round(q90 + shift, 3)
            following.append(NextCamera(target.camera, target.id, chance, *times))
        return Prediction(here.camera, here.id, t, track, self.topology.version, leave / kept, following)

    def _odds(
        self,
        zone: int,
        outcomes: Outcomes,
        t: float,
        passage: Passage | None,
        observed: bool,
        elapsed: float = 0.0,
        slower: float = 1.0,
    ) -> Floats:
        """Odds of every (target, lag bin), (targets, bins), beside those of not being seen again.

        ``observed``: the exit has been, so that arrivals have it among their causes. ``elapsed``: what is known so many
        seconds after it, of an object that takes ``slower`` times as long as usual; bins are at its pace then.
        """
        bins, past, since = self._hazards.bins, self._hazards.past, -math.inf if passage is None else passage.t
        camera = self.zones[zone].camera
        if passage is None:
            exposed = outcomes.exposure
        else:
            exposed = np.where(past, np.clip((bins.edges[1:] + (t - since)) / bins.widths, 0.0, 1.0), 1.0)
        prior = outcomes.hazard * bins.widths * exposed
        later = self._ahead_of[outcomes.targets] - self._ahead[camera]
        found = self._recent(t, since, zone)
        before = len(found)
        if elapsed:
            edges = paced(bins.edges, slower)
            came_since, remembered = self._since(t, elapsed, camera)
            found = np.concatenate((found, came_since))
            prior *= unknown(edges, elapsed, remembered, later)
        else:
            prior = np.where(bins.edges[1:] <= -later[:, None], 0.0, prior)
        mass: Floats = prior * np.array([self._alive(k) for k in outcomes.targets])[:, None]
        there, came = self._arrivals.zone[found], self._arrivals.t[found]
        self._row_of[outcomes.targets] = np.arange(len(outcomes.targets))
        k, at = self._row_of[there], bins.index(paced(came - t, 1.0 / slower) if elapsed else came - t)
        self._row_of[outcomes.targets] = -1
        some = np.flatnonzero((k >= 0) & (at >= 0))
        k, at, there, came, rate = k[some], at[some], there[some], came[some], self._arrivals.rate[found[some]]
        here = outcomes.hazard[k, at] * exposed[at]
        if elapsed:
            here *= (bins.widths / np.diff(edges))[at]
        if observed:
            rate = rate - self._hazards.rates_from(zone, there, came - t)
        if passage is not None:
            entered = self._hazards.rates_entered(passage.entry, there, came - since)
            own = entered if observed else entered + self._hazards.rates_ahead(camera, there)
            if elapsed:  # those who came after the exit: not from within the view, though it was not known any better
                in_view = some < before
                own = own * (in_view if observed else self._camera_of[there] != self._camera_of[zone])
                entered = entered * in_view
            here = here + entered
            rate = rate - own
        np.add.at(mass, (k, at), here / np.maximum(rate, RATE_MIN))
        return mass

    def _has_left(self, zone: int, t: float) -> bool:
        """Whether an exit there and then has been observed."""
        times, zones = self._exits.after(-math.inf)
        return bool(((times == t) & (zones == zone)).any())

    def _since(self, t: float, elapsed: float, camera: str) -> tuple[NDArray[np.intp], float]:
        """Arrivals (indices) from an exit until ``elapsed`` seconds after it, clocks taken as they are; and from how
        many seconds after it on they are remembered.
        """
        arrivals = self._arrivals
        first = arrivals.first
        zones = arrivals.zone[first : arrivals.stop]
        shown = arrivals.t[first : arrivals.stop] + (self._ahead_of[zones] - self._ahead[camera])
        remembered = float(shown[0]) - t if len(shown) >= RECENT_MAX else -math.inf
        return np.flatnonzero((shown >= t) & (shown <= t + elapsed)) + first, remembered

    def _recent(self, t: float, since: float, zone: int) -> NDArray[np.intp]:
        """Arrivals (indices, newest first) in other views from ``since`` on that were there by ``t``, clocks taken as
        they are, and could be the object leaving at ``zone`` at ``t``.
        """
        arrivals, targets = self._arrivals, self._hazards.seen_before(zone)
        first, oldest = arrivals.first, max(t + self._hazards.bins.lag_min, since)
        self._wanted[targets] = True
        found = np.flatnonzero(self._wanted[arrivals.zone[first : arrivals.stop]])[::-1] + first
        self._wanted[targets] = False
        if len(found):
            came = arrivals.t[found]
            later = self._ahead_of[arrivals.zone[found]] - self._ahead[self.zones[zone].camera]
            found = found[(came + later < t) & (came > since) & (came >= oldest)]
        return found

    def _causes(self, zone: int, t: float) -> dict[str, float]:
        """Rate (1/s) at which those who have left each camera and those still in its view could cause an arrival now.

        What comes from outside is not among them.
        """
        left, zones = self._exits.after(t - self._hazards.bins.lag_max - self._clocks_apart)
        sources, rates = self._hazards.rates(zones, zone, t - left)
        total = np.bincount(self._camera_of[sources], rates, minlength=len(self._names))
        causes = {self._names[k]: float(total[k]) for k in np.flatnonzero(total)}
        here, kernels, further = self.zones[zone].camera, self._hazards.kernels_to(zone), []
        for camera in self._hazards.cameras_ahead(zone):
            if camera == here:
                continue
            ahead, rate, first = self._hazards.rate_ahead(camera, zone), causes.get(camera, 0.0), None
            for place, passage in self._under_way.in_view(camera):
                one = ahead
                if passage.entry in kernels:
                    one += self._hazards.rate_entered(passage.entry, zone, t - passage.t)
                if one:
                    rate += one
                    first = first or place
            if first is not None:
                further.append((first, camera, rate))
        causes.update((camera, rate) for _, camera, rate in sorted(further))  # as they came: sums depend on the order
        return causes

    def _alive(self, zone: int) -> float:
        """Probability that the zone's camera still reports, from how many events of others it has let pass."""
        camera = self.zones[zone].camera
        silent = (self._events - self._last_event[camera]) * self._share.get(camera, 0.0)
        return 1.0 / (1.0 + DEAD_PRIOR * math.exp(min(silent, SILENCE_NATS_MAX)))


def _check(t: float, now: float | None) -> None:
    if now is not None and not t <= now < math.inf:
        raise ValueError(f"now is {now}: give the time of the exit, {t}, or a later one, in seconds")


def _log_density(zone: Zone, x: float, y: float) -> float:
    """Log of the zone's weighted normal density at a point (thesis 2.8) up to a constant; least without a shape.

    A zone may be as narrow as a line, so the spread of a cell is added, as where zones are learned.
    """
    if zone.cov is None or zone.x is None or zone.y is None:
        return -math.inf
    (a, b), (_, d) = zone.cov
    a, d = a + 1 / (12 * GRID_COLUMNS**2), d + 1 / (12 * GRID_ROWS**2)
    dx, dy = x - zone.x, y - zone.y
    det = a * d - b * b
    distance = (d * dx * dx - 2 * b * dx * dy + a * dy * dy) / det
    return math.log(max(zone.entries + zone.exits, 1)) - 0.5 * math.log(det) - 0.5 * distance
