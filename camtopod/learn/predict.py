"""Where an object that has just left will appear next: competing outcomes, weighed by what has been seen since.

For an exit at zone u the outcomes are: appearing at each zone v with a lag, or not being seen again. Their prior odds
are the learned hazards, all of them, weak evidence included. Three things are then known at the time of the exit:

* *exposure*: a lag of -L is only possible if this passage has lasted L;
* *seen*: where views overlap the object may already have appeared; each recent arrival counts for its hazard over the
  rate of everything else that could have caused it, and an overlapped view without an arrival loses its share;
* *alive*: a camera silent for far longer than its traffic allows is not where objects will be seen.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.joint import LEAVE_FLOOR, smooth
from camtopod.learn.lags import LagBins
from camtopod.records import Event, Link, NextCamera, Prediction, Topology, Transit, Zone

Floats = NDArray[np.float64]

RECENT_MAX = 2000
"""Recent arrivals, and passages under way, that are remembered, each."""
DEAD_PRIOR = 1e-3
"""Prior probability that a camera has gone silent for good."""
SILENCE_NATS_MAX = 50.0
NEXT_PROBABILITY_MIN = 1e-4
"""Outcomes less likely than this are left out."""
UNKNOWN_STAY_SECONDS = 10.0
NORMAL_Q90 = 1.2816


class _Source(NamedTuple):
    """The outcomes of leaving at one zone."""

    targets: list[int]
    hazard: Floats
    """(targets, bins) per second and exposed departure."""
    exposure: Floats
    """(bins,) share of the departures here that are exposed."""


class _Passage(NamedTuple):
    t: float
    zone: int


class Predictor:
    """Prediction over one topology version. `observe` keeps it abreast of events; `predict` answers for an exit."""

    def __init__(self, topology: Topology) -> None:
        self.topology = topology
        model = topology.model
        scale, step = (model.lag_scale, model.lag_step) if model else (4.0, 0.1)
        low, high = (model.lag_min, model.lag_max) if model else _lag_range(topology)
        self.bins = LagBins(low, high, scale, step)
        self.zones = topology.zones
        self._index = {zone.id: k for k, zone in enumerate(self.zones)}
        self._of_camera: dict[str, list[int]] = {}
        for k, zone in enumerate(self.zones):
            self._of_camera.setdefault(zone.camera, []).append(k)
        self._arrival_rate = np.zeros(len(self.zones))
        self._stay: list[list[float]] = [[] for _ in self.zones]
        for entry in model.zones if model else []:
            self._arrival_rate[self._index[entry.zone]] = entry.arrival_rate
            self._stay[self._index[entry.zone]] = entry.stay
        self._share = {camera.camera: camera.share for camera in (model.cameras if model else [])}
        self._sources = self._read_links([*topology.links, *(topology.weak_links or [])])
        self._arrivals: deque[tuple[float, int]] = deque(maxlen=RECENT_MAX)
        self._exits: deque[tuple[float, float, int]] = deque(maxlen=RECENT_MAX)
        self._open: dict[tuple[str, str], _Passage] = {}
        self._events = 0
        self._last_event = dict.fromkeys(self._of_camera, 0)

    def follow(self, topology: Topology) -> Predictor:
        """A predictor over a newer version that remembers what this one has observed."""
        newer = Predictor(topology)
        moved = {k: newer._index[zone.id] for k, zone in enumerate(self.zones) if zone.id in newer._index}
        newer._arrivals.extend((t, moved[zone]) for t, zone in self._arrivals if zone in moved)
        newer._exits.extend((t, since, moved[zone]) for t, since, zone in self._exits if zone in moved)
        newer._open = {key: _Passage(p.t, moved[p.zone]) for key, p in self._open.items() if p.zone in moved}
        newer._events = self._events
        newer._last_event.update({c: n for c, n in self._last_event.items() if c in newer._last_event})
        for camera in newer._last_event.keys() - self._last_event.keys():
            newer._last_event[camera] = self._events
        return newer

    def observe(self, event: Event) -> None:
        """Take note of an event; they must come by time as far as that is possible."""
        self._events += 1
        if event.camera in self._last_event:
            self._last_event[event.camera] = self._events
        zone = self.zone_of(event)
        if zone is None:
            return
        key = (event.camera, str(event.track))
        if event.kind == "entry":
            self._arrivals.append((event.t, zone))
            if event.track is not None:
                self._open[key] = _Passage(event.t, zone)
                if len(self._open) > RECENT_MAX:
                    del self._open[next(iter(self._open))]
        else:
            began = self._open.pop(key, None) if event.track is not None else None
            self._exits.append((event.t, began.t if began else -np.inf, zone))

    def zone_of(self, event: Event) -> int | None:
        """Index of the zone the event most likely belongs to; None for a camera without zones."""
        candidates = self._of_camera.get(event.camera)
        if not candidates:
            return None
        if event.x is None or event.y is None:
            return max(candidates, key=lambda k: self.zones[k].entries + self.zones[k].exits)
        return max(candidates, key=lambda k: _log_density(self.zones[k], event.x or 0.0, event.y or 0.0))

    def predict(self, event: Event) -> Prediction:
        """Next appearance of the object of an exit. The event itself need not have been observed."""
        zone = self.zone_of(event)
        track = None if event.track is None else str(event.track)
        if zone is None:
            return Prediction(event.camera, None, event.t, track, self.topology.version, 1.0, [])
        began = self._open.get((event.camera, str(event.track))) if event.track is not None else None
        return self.predict_from(zone, event.t, began.t if began else None, track)

    def predict_from(self, zone: int, t: float, since: float | None = None, track: str | None = None) -> Prediction:
        """The same for an object that left zone ``zone`` (index) at ``t`` after a passage begun at ``since``, if
        known.
        """
        here, source = self.zones[zone], self._sources.get(zone)
        version = self.topology.version
        if source is None:
            return Prediction(here.camera, here.id, t, track, version, 1.0, [])
        mass, leave = self._outcomes(source, t, since)
        odds = mass.sum(axis=1)
        total = leave + float(odds.sum())
        order = [int(k) for k in np.argsort(-odds, kind="stable") if odds[k] >= NEXT_PROBABILITY_MIN * total]
        kept = leave + float(odds[order].sum())
        following = []
        for k in order:
            target = self.zones[source.targets[k]]
            q10, q50, q90 = (round(q, 3) for q in self._quantiles(mass[k]))
            following.append(NextCamera(target.camera, target.id, float(odds[k]) / kept, q10, q50, q90))
        return Prediction(here.camera, here.id, t, track, version, leave / kept, following)

    def _outcomes(self, source: _Source, t: float, since: float | None) -> tuple[Floats, float]:
        """Odds of every (target, lag bin), (targets, bins), and of not being seen again."""
        edges = self.bins.edges
        past = edges[1:] <= 0
        if since is None:
            exposed = np.where(past, source.exposure, 1.0)
        else:
            exposed = np.where(past, np.clip((edges[1:] + (t - since)) / self.bins.widths, 0.0, 1.0), 1.0)
        prior = source.hazard * self.bins.widths * exposed
        leave = max(1.0 - float(prior.sum()), LEAVE_FLOOR)
        mass = np.where(past, 0.0, prior) * np.array([self._alive(k) for k in source.targets])[:, None]
        column = {target: k for k, target in enumerate(source.targets)}
        for came, zone in reversed(self._arrivals):
            lag = came - t
            if lag < self.bins.lag_min:
                break
            k = column.get(zone)
            if k is None or lag >= 0 or (since is not None and came <= since):
                continue
            at = int(self.bins.index(np.array([lag]))[0])
            if at >= 0 and source.hazard[k, at] > 0:
                mass[k, at] += source.hazard[k, at] * exposed[at] / self._others(zone, came)
        return mass, leave

    def _others(self, zone: int, came: float) -> float:
        """Rate (1/s) at which everything but the object asked for could have caused an arrival at ``zone``."""
        rate = float(self._arrival_rate[zone]) + 1e-6
        camera = self.zones[zone].camera
        for left, since, origin in reversed(self._exits):
            if came - left > self.bins.lag_max:
                break
            if since < came:
                rate += self._hazard(origin, zone, came - left)
        for (where, _), passage in self._open.items():
            if where != camera and passage.t < came:
                rate += self._mean_hazard(where, zone)
        return rate

    def _hazard(self, origin: int, zone: int, lag: float) -> float:
        source = self._sources.get(origin)
        if source is None or zone not in source.targets:
            return 0.0
        at = int(self.bins.index(np.array([lag]))[0])
        return float(source.hazard[source.targets.index(zone), at]) if at >= 0 else 0.0

    def _mean_hazard(self, camera: str, zone: int) -> float:
        """Rate at which an object in the view of ``camera`` appears at ``zone`` before it leaves."""
        past = self.bins.edges[1:] <= 0
        exits = sum(self.zones[k].exits for k in self._of_camera[camera])
        rate = 0.0
        for k in self._of_camera[camera]:
            source = self._sources.get(k)
            if source is None or zone not in source.targets:
                continue
            row = source.hazard[source.targets.index(zone)]
            stay = self._stay[k][5] if self._stay[k] else UNKNOWN_STAY_SECONDS
            ahead = float((row * self.bins.widths * source.exposure)[past].sum())
            rate += self.zones[k].exits / max(exits, 1) * ahead / max(stay, 1.0)
        return rate

    def _alive(self, zone: int) -> float:
        """Probability that the zone's camera still reports, from how many events of others it has let pass."""
        camera = self.zones[zone].camera
        silent = (self._events - self._last_event[camera]) * self._share.get(camera, 0.0)
        return 1.0 / (1.0 + DEAD_PRIOR * float(np.exp(min(silent, SILENCE_NATS_MAX))))

    def _quantiles(self, mass: Floats) -> list[float]:
        """q10, q50, q90 (seconds) of a row of lag-bin masses."""
        reached = np.concatenate(([0.0], np.cumsum(mass)))
        return [float(np.interp(q * reached[-1], reached, self.bins.edges)) for q in (0.1, 0.5, 0.9)]

    def _read_links(self, links: list[Link]) -> dict[int, _Source]:
        """Hazards by source zone. A link without a histogram is spread as its quantiles say."""
        grouped: dict[int, list[Link]] = {}
        for link in links:
            if link.relation != "visible" and link.from_ in self._index and link.to in self._index:
                grouped.setdefault(self._index[link.from_], []).append(link)
        sources = {}
        for zone, out in grouped.items():
            counts = np.stack([_counts(link, self.bins) for link in out])
            exposure = self._exposure(zone)
            share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1e-300)
            spread, _ = smooth(counts)
            spread /= np.maximum(spread.sum(axis=1, keepdims=True), 1e-300)
            spread = np.where(share.sum(axis=1, keepdims=True) > 0, spread, share)
            probability = np.array([link.probability for link in out])[:, None]
            hazard = probability * spread / (self.bins.widths * exposure)
            sources[zone] = _Source([self._index[link.to] for link in out], hazard, exposure)
        return sources

    def _exposure(self, zone: int) -> Floats:
        """Share (bins,) of the passages leaving at the zone that had begun by the lag; 1 for lags after the exit."""
        past = self.bins.edges[1:] <= 0
        stay = self._stay[zone]
        if not stay:
            return np.ones(self.bins.size)
        began = 1.0 - np.interp(-self.bins.centres, stay, np.linspace(0.0, 1.0, len(stay)))
        return np.where(past, np.clip(began, 0.02, 1.0), 1.0)


def _lag_range(topology: Topology) -> tuple[float, float]:
    """Lags to look at when the topology does not say: what its links need."""
    low = min((link.transit.q10 for link in topology.links), default=0.0)
    high = max((link.transit.q90 for link in topology.links), default=60.0)
    return min(2.0 * low, 0.0), max(2.0 * high, 1.0)


def _counts(link: Link, bins: LagBins) -> Floats:
    """The link's histogram on the bins, (bins,)."""
    counts = np.zeros(bins.size)
    if link.histogram is not None:
        start = link.histogram.first - bins.first
        for k, mass in enumerate(link.histogram.mass):
            if 0 <= start + k < bins.size:
                counts[start + k] += mass
        return counts
    transit: Transit = link.transit
    sd = max((transit.q90 - transit.q10) / (2 * NORMAL_Q90), 0.5)
    shape = np.exp(-0.5 * ((bins.centres - transit.q50) / sd) ** 2) * bins.widths
    return shape / max(float(shape.sum()), 1e-300) * link.transitions


def _log_density(zone: Zone, x: float, y: float) -> float:
    """Log of the zone's weighted normal density at a point (thesis 2.8), up to a constant; a zone without shape is
    last.
    """
    if zone.cov is None or zone.x is None or zone.y is None:
        return -np.inf
    (a, b), (_, d) = zone.cov
    dx, dy = x - zone.x, y - zone.y
    det = max(a * d - b * b, 1e-12)
    distance = (d * dx * dx - 2 * b * dx * dy + a * dy * dy) / det
    return float(np.log(max(zone.entries + zone.exits, 1)) - 0.5 * np.log(det) - 0.5 * distance)
