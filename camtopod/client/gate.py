"""What the learned topology says about who is who across cameras: the prior of a tracker's association.

An object that leaves a zone appears next somewhere, some time, or is not seen again: one of these, with the odds and
transit times that prediction uses (`camtopod.learn.predict`; the thesis has the times in 4.5, and a Markov chain over
cameras for the odds in 4.6). An object that appears has left some zone before, or comes from outside, which happens at
a steady rate. All as logarithms, so that they add up with those of other evidence:

    gate(...)      ln of 1/s   who left here then appears next there then
    gate_new(...)  ln of 1/s   somebody from outside appears there then
    gate_gone(...) ln of 1     who left here then is not to be seen (yet)

``gate - gate_new - gate_gone`` is the log odds of an exit and an entry being one object's against their being two
objects'; `Gate.affinity` has them for many. The matching with the largest sum is the likeliest of all matchings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.client.errors import zone_at, zones_of
from camtopod.learn.hazards import Hazards
from camtopod.learn.positions import block_of
from camtopod.learn.predict import Predictor
from camtopod.learn.surroundings import Surroundings
from camtopod.records import Event, Kind, Topology

Floats = NDArray[np.float64]

OUTSIDE_SHARE_MIN = 0.05
"""Zones with a smaller share of entries from outside do not tell how long was learned from."""


class _Onward(NamedTuple):
    """Where who left a zone appears next; all of it sums to 1."""

    targets: list[int]
    chance: Floats
    """(targets, bins) probability of appearing there in each lag bin."""
    gone: float
    """Probability of not being seen again."""


class Gate:
    """The log-priors of one version of the topology. Does not change; any thread may ask.

    Times are seconds since the epoch by the clock of the camera where they were taken, as in events; what the version
    knows of the clocks is taken into account. While little has been learned the odds are too sure, as predictions are.
    Without a daemon: ``Gate(topology)`` of a topology read from a file.
    """

    def __init__(self, topology: Topology, predictor: Predictor | None = None) -> None:
        """``predictor``: one over the same topology, where there is one already."""
        self.topology = topology
        self._predictor = predictor or Predictor(topology)
        self._hazards = Hazards(topology)
        self._surroundings = Surroundings(topology)
        self._ahead = {camera.id: camera.clock_offset for camera in topology.cameras}
        self._new = self._rates_from_outside()

    def gate(self, from_zone: str, t_exit: float, to_camera: str, t_entry: float, to_zone: str | None = None) -> float:
        """ln of the density, in 1/s of ``t_entry``, with which an object that left ``from_zone`` at ``t_exit`` appears
        next at ``to_camera`` at ``t_entry``; at ``to_zone`` of it, if given.

        Over all times the density sums to the probability of appearing there next; over all cameras, too, to 1 less
        that of not being seen again. It is a step function: constant within a bin of some percent of the lag. Where
        views overlap, ``t_entry`` may be before ``t_exit``. -inf where no way has been learned that takes this
        long: for the topology, not for ever. Raises ValueError for times that are not finite numbers.

        ``from_zone`` is a zone's id (``lobby/1``). Raises `UnknownPlace`, a KeyError, for a zone or camera that this
        version does not have: zones come and go with versions, so of events better take `affinity`, which finds them by
        their positions.
        """
        source = zone_at(self.topology, from_zone)
        to = self._zones(to_camera, to_zone)
        onward = self._onward(source)
        lag = (t_entry - self._ahead[to_camera]) - (t_exit - self._ahead[self.topology.zones[source].camera])
        if not math.isfinite(lag):
            raise ValueError(f"t_exit {t_exit} and t_entry {t_entry}: finite numbers of seconds")
        at = int(self._hazards.bins.index(np.array([lag]))[0])
        rows = [row for row, target in enumerate(onward.targets) if target in to]
        chance = float(onward.chance[rows, at].sum()) if at >= 0 else 0.0
        return math.log(chance / self._hazards.bins.widths[at]) if chance > 0 else -math.inf

    def gate_new(self, to_camera: str, to_zone: str | None = None) -> float:
        """ln of the rate, in 1/s, at which objects from outside appear at a camera, or at a zone of it: those that have
        not left another zone before, false ones among them. Raises `UnknownPlace`, a KeyError.

        One figure for all times: the mean over the window that was learned from.
        """
        return math.log(self._new[self._zones(to_camera, to_zone)].sum())

    def gate_gone(self, from_zone: str, seconds: float = math.inf) -> float:
        """ln of the probability that who left ``from_zone`` has not appeared anywhere ``seconds`` later; without
        ``seconds``, that they are not seen again. Raises `UnknownPlace`, a KeyError; ValueError for what is no number.
        """
        if math.isnan(seconds):
            raise ValueError("seconds is not a number")
        return math.log(self._gone(self._onward(zone_at(self.topology, from_zone)), seconds))

    def affinity(self, exits: Sequence[Event], entries: Sequence[Event], now: float | None = None) -> Floats:
        """Log odds (exits, entries), in nats, of each exit and entry being one object's against their being two
        objects'. Add the log likelihood ratios of your other evidence, appearance say, and match by

            rows, columns = scipy.optimize.linear_sum_assignment(np.maximum(odds, 0), maximize=True)

        of which those with odds above 0 are pairs: that is the likeliest matching as a whole.

        ``exits`` and ``entries`` are events as `TrackEvents` makes them, of all cameras in any order; zones are found
        by their positions. ``now``: the time, seconds, up to which entries are known, so that who may still be under
        way is not taken for gone; the newest of the given times where it is not said. -inf: no way has been learned
        that takes this long; take ``np.maximum(odds, -20)`` where other evidence shall be able to overrule that. 0, so
        neither for nor against, where this version does not know a camera. Raises ValueError for an entry among the
        exits or an exit among the entries, or a time that is not a number.
        """
        if now is not None and math.isnan(now):
            raise ValueError("now is not a number")
        _check(exits, "exit")
        _check(entries, "entry")
        odds = np.zeros((len(exits), len(entries)))
        zones = [self._predictor.zone_of(entry) for entry in entries]
        known = np.array([k for k, zone in enumerate(zones) if zone is not None], np.intp)
        if not len(known):
            return odds
        to = np.array([zone for zone in zones if zone is not None], np.intp)
        came = np.array([self._right(entries[k]) for k in known])
        left = [self._right(event) if event.camera in self._ahead else -math.inf for event in exits]
        until = max([*left, *came.tolist()]) if now is None else now
        new = np.log(self._new)[to]
        for row, event in enumerate(exits):
            zone = self._predictor.zone_of(event)
            if zone is not None:
                onward = self._onward(zone, block_of(event.x, event.y))
                gone = math.log(self._gone(onward, until - left[row]))
                odds[row, known] = self._log_density(onward, to, came - left[row]) - new - gone
        return odds

    def _rates_from_outside(self) -> Floats:
        """(zones,) per second, such that as many are expected to have come as to have left before.

        The version has the rate of arrivals that no exit explains at all. Those that may as well have come by chance
        (`Outcome.doubt`) are gone, for their exits; so for their entries they are from outside.
        """
        rate = np.array(self._hazards.arrival_rate)
        entries = np.array([float(zone.entries) for zone in self.topology.zones])
        explained, surely = np.zeros(len(rate)), np.zeros(len(rate))
        for zone, outcomes in self._hazards.outcomes.items():
            departures = self._hazards.departures[zone]
            explained[outcomes.targets] += departures * outcomes.share
            surely[outcomes.targets] += departures * self._onward(zone).chance.sum(axis=1)
        some = entries - explained > OUTSIDE_SHARE_MIN * entries
        if not some.any():
            return rate
        span = np.median((entries - explained)[some] / rate[some])  # seconds, of what was learned from
        balanced: Floats = np.maximum(rate, (entries - surely) / span)
        return balanced

    def _zones(self, camera: str, zone: str | None) -> list[int]:
        return zones_of(self.topology, camera) if zone is None else [zone_at(self.topology, zone, camera)]

    def _right(self, event: Event) -> float:
        """The event's time by right clocks."""
        return event.t - self._ahead[event.camera]

    def _onward(self, zone: int, block: int | None = None) -> _Onward:
        """As the predictor has it for an exit of which only the place is known, before anything has been seen since."""
        outcomes, bins = self._hazards.outcomes.get(zone), self._hazards.bins
        if outcomes is None:
            return _Onward([], np.zeros((0, bins.size)), 1.0)
        likelier, leave = self._surroundings.multipliers(zone, outcomes, block, None, None, 0.0)
        odds = outcomes.hazard * bins.widths * outcomes.exposure * np.array(likelier)[:, None]
        doubtful = outcomes.doubt[:, None] * odds
        leave += float(doubtful.sum())
        total = leave + float((odds - doubtful).sum())
        return _Onward(outcomes.targets, (odds - doubtful) / total, leave / total)

    def _gone(self, onward: _Onward, seconds: float) -> float:
        """Probability of not having been seen ``seconds`` after the exit."""
        bins = self._hazards.bins
        later = np.clip((bins.edges[1:] - seconds) / bins.widths, 0.0, 1.0)
        return onward.gone + float((onward.chance @ later).sum())

    def _log_density(self, onward: _Onward, zones: NDArray[np.intp], lag: Floats) -> Floats:
        """ln of 1/s of appearing at zones (m,) with lags (m,) in seconds."""
        row_of = np.full(len(self.topology.zones), -1)
        row_of[onward.targets] = np.arange(len(onward.targets))
        row, at = row_of[zones], self._hazards.bins.index(lag)
        some = np.flatnonzero((row >= 0) & (at >= 0))
        density = np.zeros(len(zones))
        density[some] = onward.chance[row[some], at[some]] / self._hazards.bins.widths[at[some]]
        with np.errstate(divide="ignore"):
            return np.log(density)


def _check(events: Sequence[Event], kind: Kind) -> None:
    for event in events:
        if event.kind != kind:
            raise ValueError(f"an {event.kind} of {event.camera} at {event.t} among what should be {kind} events")
        if not math.isfinite(event.t):
            raise ValueError(f"an {event.kind} of {event.camera} at {event.t}: not a finite number of seconds")
