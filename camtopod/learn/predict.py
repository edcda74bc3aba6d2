"""Where an object that has just left will appear next: competing outcomes, weighed by what has been seen since.

For an exit at zone u the outcomes are: appearing at each zone v with a lag, or not being seen again. Their prior odds
are the learned hazards, all of them, weak evidence included. Five things are then known at the time of the exit:

* *context*: where the object came in, where exactly it left, from which camera it probably came before;
* *exposure*: a lag of -L is only possible if this passage has lasted L;
* *seen*: where views overlap the object may already have appeared; each recent arrival counts for its hazard over the
  rate of everything else that could have caused it, and an overlapped view without an arrival loses its share;
* *pace*: who was slow in this view takes longer to the next;
* *alive*: a camera silent for far longer than its traffic allows is not where objects will be seen.

Events come with their cameras' own clocks; inside, times are right ones, as far as the topology knows the clocks.
"""

from __future__ import annotations

import math
from collections import deque

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.learn.hazards import Hazards, Outcomes
from camtopod.learn.pace import Paces
from camtopod.learn.scene import block_of
from camtopod.learn.settings import GRID_COLUMNS, GRID_ROWS
from camtopod.learn.surroundings import Surroundings
from camtopod.records import Event, NextCamera, Prediction, Topology, Zone

Floats = NDArray[np.float64]

RECENT_MAX = 2000
"""Recent arrivals, recent exits, and passages under way that are remembered, each."""
UNDER_WAY_SECONDS_MAX = 600.0
"""A passage without an exit is forgotten after this, or after the longest known at its camera."""
DEAD_PRIOR = 1e-3
"""Prior probability that a camera has gone silent for good."""
SILENCE_NATS_MAX = 50.0
NEXT_PROBABILITY_MIN = 1e-4
"""Outcomes less likely than this are left out."""
RATE_MIN = 1e-6


class _Arrival(Struct):
    t: float
    zone: int
    rate: float
    """Rate (1/s) at which all that is known so far could have caused it."""


class _Exits:
    """The recent exits by time, as columns."""

    def __init__(self) -> None:
        self.t = np.zeros(2 * RECENT_MAX)
        self.zone = np.zeros(2 * RECENT_MAX, np.int32)
        self._stop = 0

    def save(self) -> tuple[Floats, NDArray[np.int32]]:
        return self.t[: self._stop].copy(), self.zone[: self._stop].copy()

    def load(self, t: Floats, zone: NDArray[np.int32]) -> None:
        self._stop = len(t)
        self.t[: self._stop], self.zone[: self._stop] = t, zone

    def append(self, t: float, zone: int) -> None:
        if self._stop == len(self.t):
            self._stop = RECENT_MAX
            self.t[:RECENT_MAX], self.zone[:RECENT_MAX] = self.t[RECENT_MAX:], self.zone[RECENT_MAX:]
        self.t[self._stop], self.zone[self._stop] = t, zone
        self._stop += 1

    def after(self, t: float) -> tuple[Floats, NDArray[np.int32]]:
        """Times and zones (n,) of those later than ``t``, as far as events come by time."""
        first = max(int(np.searchsorted(self.t[: self._stop], t)), self._stop - RECENT_MAX, 0)
        return self.t[first : self._stop], self.zone[first : self._stop]


class _Passage(Struct):
    t: float
    camera: str
    entry: int
    """Zone of entry."""
    previous: str | None = None
    """Camera it most probably came from, and the probability of that."""
    sure: float = 0.0


class PredictorState(Struct):
    """What a `Predictor` has observed; what it knows beside that is its topology."""

    arrivals: list[_Arrival]
    exit_times: Floats
    exit_zones: NDArray[np.int32]
    under_way: list[tuple[str, str, _Passage]]
    events: int
    last_event: dict[str, int]


class Predictor:
    """Prediction over one topology version. `observe` keeps it abreast of events; `predict` answers for an exit.

    An exit is to be predicted before it is observed, else it competes with itself.
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
        self._stay_max = {
            camera: self._hazards.longest_stay(zones) or UNDER_WAY_SECONDS_MAX
            for camera, zones in self._of_camera.items()
        }
        self._arrivals: deque[_Arrival] = deque(maxlen=RECENT_MAX)
        self._exits = _Exits()
        self._names = list(self._of_camera)
        number = {camera: k for k, camera in enumerate(self._names)}
        self._camera_of = np.array([number[zone.camera] for zone in self.zones], np.int32)
        self._under_way: dict[tuple[str, str], _Passage] = {}
        self._events = 0
        self._last_event = dict.fromkeys(self._of_camera, 0)

    def follow(self, topology: Topology) -> Predictor:
        """A predictor over a newer version that remembers what this one has observed."""
        newer = Predictor(topology)
        index = {zone.id: k for k, zone in enumerate(newer.zones)}
        moved = {k: index[zone.id] for k, zone in enumerate(self.zones) if zone.id in index}
        newer._arrivals.extend(_Arrival(a.t, moved[a.zone], a.rate) for a in self._arrivals if a.zone in moved)
        for t, zone in zip(*(column.tolist() for column in self._exits.after(-math.inf)), strict=True):
            if zone in moved:
                newer._exits.append(t, moved[zone])
        newer._under_way = {
            key: msgspec.structs.replace(passage, entry=moved[passage.entry])
            for key, passage in self._under_way.items()
            if passage.entry in moved
        }
        newer._events = self._events
        newer._last_event = {camera: self._last_event.get(camera, self._events) for camera in newer._of_camera}
        return newer

    def save(self) -> PredictorState:
        """Everything `load` needs, beside the topology, to go on from here."""
        under_way = [(camera, track, passage) for (camera, track), passage in self._under_way.items()]
        exits = self._exits.save()
        return PredictorState(list(self._arrivals), *exits, under_way, self._events, self._last_event)

    def load(self, state: PredictorState) -> None:
        """Go on from there, over the same topology."""
        self._arrivals.extend(state.arrivals)
        self._exits.load(state.exit_times, state.exit_zones)
        self._under_way = {(camera, track): passage for camera, track, passage in state.under_way}
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
            self._arrivals.append(_Arrival(t, zone, rate))
            if event.track is not None:
                previous = max(causes, key=lambda camera: causes[camera], default=None)
                sure = causes[previous] / rate if previous is not None else 0.0
                self._under_way[event.camera, str(event.track)] = _Passage(t, event.camera, zone, previous, sure)
                self._forget_stale(t)
            return
        passage = self._under_way.pop((event.camera, str(event.track)), None)
        since = passage.t if passage else -math.inf
        self._exits.append(t, zone)
        for arrival in self._recent(t, since, event.camera):
            before = self._hazards.rate_ahead(event.camera, arrival.zone) if passage else 0.0
            arrival.rate += self._hazards.rate(zone, arrival.zone, arrival.t - t) - before

    def zone_of(self, event: Event) -> int | None:
        """Index of the zone the event most likely belongs to; None for a camera without zones."""
        candidates = self._of_camera.get(event.camera)
        if not candidates:
            return None
        if event.x is None or event.y is None:
            return max(candidates, key=lambda k: self.zones[k].entries + self.zones[k].exits)
        x, y = event.x, event.y
        return max(candidates, key=lambda k: _log_density(self.zones[k], x, y))

    def predict(self, event: Event) -> Prediction:
        """Next appearance of the object of an exit."""
        zone = self.zone_of(event)
        track = None if event.track is None else str(event.track)
        if zone is None:
            return Prediction(event.camera, None, event.t, track, self.topology.version, 1.0, [])
        passage = self._under_way.get((event.camera, str(event.track))) if event.track is not None else None
        return self.predict_from(zone, event.t, passage, track, block_of(event.x, event.y))

    def predict_from(
        self, zone: int, t: float, passage: _Passage | None = None, track: str | None = None, block: int | None = None
    ) -> Prediction:
        """The same for an object that left a zone (index) at ``t`` by the clock of the zone's camera, after a passage
        and in a block of the image, if known.
        """
        here, outcomes = self.zones[zone], self._hazards.outcomes.get(zone)
        if outcomes is None:
            return Prediction(here.camera, here.id, t, track, self.topology.version, 1.0, [])
        mass = self._odds(here.camera, outcomes, t - self._ahead[here.camera], passage)
        known = (None, None, 0.0) if passage is None else (passage.entry, passage.previous, passage.sure)
        likelier, leave = self._surroundings.multipliers(zone, outcomes, block, *known)
        mass *= likelier[:, None]
        odds = mass.sum(axis=1)
        leave += float((outcomes.doubt * odds).sum())
        odds *= 1.0 - outcomes.doubt
        total = leave + float(odds.sum())
        order = [int(k) for k in np.argsort(-odds, kind="stable") if odds[k] >= NEXT_PROBABILITY_MIN * total]
        kept = leave + float(odds[order].sum())
        following = []
        stay = None if passage is None else t - self._ahead[here.camera] - passage.t
        entry, departures = None if passage is None else passage.entry, self._hazards.departures[zone]
        for k in order:
            target = self.zones[outcomes.targets[k]]
            reached = np.concatenate(([0.0], np.cumsum(mass[k])))
            usual = np.interp(np.array((0.1, 0.5, 0.9)) * reached[-1], reached, self._hazards.bins.edges)
            q10, q50, q90 = self._paces.window(entry, zone, stay, outcomes.share[k] * departures, *usual.tolist())
            shift = 0.0 if self._corrected else self._later(here.camera, outcomes.targets[k])
            times = (round(float(q) + shift, 3) for q in (q10, q50, q90))
            following.append(NextCamera(target.camera, target.id, float(odds[k]) / kept, *times))
        return Prediction(here.camera, here.id, t, track, self.topology.version, leave / kept, following)

    def _odds(self, camera: str, outcomes: Outcomes, t: float, passage: _Passage | None) -> Floats:
        """Odds of every (target, lag bin), (targets, bins), beside those of not being seen again."""
        bins, past, since = self._hazards.bins, self._hazards.past, -math.inf if passage is None else passage.t
        if passage is None:
            exposed = outcomes.exposure
        else:
            exposed = np.where(past, np.clip((bins.edges[1:] + (t - since)) / bins.widths, 0.0, 1.0), 1.0)
        prior = outcomes.hazard * bins.widths * exposed
        later = np.array([self._later(camera, k) for k in outcomes.targets])
        mass: Floats = (
            np.where(bins.edges[1:] <= -later[:, None], 0.0, prior)
            * np.array([self._alive(k) for k in outcomes.targets])[:, None]
        )
        row = {target: k for k, target in enumerate(outcomes.targets)}
        for arrival in self._recent(t, since, camera):
            k = row.get(arrival.zone)
            lag = arrival.t - t
            if k is None or lag > bins.lag_max:
                continue
            at = math.floor(math.asinh(lag / bins.scale) / bins.step) - bins.first
            entered = own = 0.0
            if passage is not None:
                entered = self._hazards.rate_entered(passage.entry, arrival.zone, arrival.t - since)
                own = entered + self._hazards.rate_ahead(camera, arrival.zone)
            here = outcomes.hazard[k, at] * exposed[at] + entered
            mass[k, at] += here / max(arrival.rate - own, RATE_MIN)
        return mass

    def _recent(self, t: float, since: float, camera: str) -> list[_Arrival]:
        """Arrivals in other views from ``since`` on that were there by ``t``, clocks taken as they are, and could be
        the object leaving ``camera`` at ``t``.
        """
        found, oldest = [], max(t + self._hazards.bins.lag_min, since)
        for arrival in reversed(self._arrivals):
            if arrival.t < oldest - self._clocks_apart:
                break
            known = arrival.t + self._later(camera, arrival.zone) < t
            if known and arrival.t > since and arrival.t >= oldest and self.zones[arrival.zone].camera != camera:
                found.append(arrival)
        return found

    def _later(self, camera: str, zone: int) -> float:
        """By how much lags from a camera to a zone are longer by those cameras' clocks than in truth, seconds."""
        return self._ahead[self.zones[zone].camera] - self._ahead[camera]

    def _causes(self, zone: int, t: float) -> dict[str, float]:
        """Rate (1/s) at which those who have left each camera and those still in its view could cause an arrival now.

        What comes from outside is not among them.
        """
        left, zones = self._exits.after(t - self._hazards.bins.lag_max - self._clocks_apart)
        rates = self._hazards.rates(zones, zone, t - left)
        total = np.bincount(self._camera_of[zones], rates, minlength=len(self._names))
        causes = {self._names[k]: float(total[k]) for k in np.flatnonzero(total)}
        here = self.zones[zone].camera
        for passage in self._under_way.values():
            if passage.camera != here:
                rate = self._hazards.rate_ahead(passage.camera, zone)
                rate += self._hazards.rate_entered(passage.entry, zone, t - passage.t)
                if rate:
                    causes[passage.camera] = causes.get(passage.camera, 0.0) + rate
        return causes

    def _forget_stale(self, now: float) -> None:
        """Forget the oldest passages under way: those that have lasted too long, and any beyond the limit."""
        while self._under_way:
            key, oldest = next(iter(self._under_way.items()))
            fresh = now - oldest.t <= self._stay_max.get(oldest.camera, UNDER_WAY_SECONDS_MAX)
            if fresh and len(self._under_way) <= RECENT_MAX:
                return
            del self._under_way[key]

    def _alive(self, zone: int) -> float:
        """Probability that the zone's camera still reports, from how many events of others it has let pass."""
        camera = self.zones[zone].camera
        silent = (self._events - self._last_event[camera]) * self._share.get(camera, 0.0)
        return 1.0 / (1.0 + DEAD_PRIOR * math.exp(min(silent, SILENCE_NATS_MAX)))


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
