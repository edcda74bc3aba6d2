"""What the learned topology says about who is who across cameras: the prior of a tracker's
association.

An object that leaves a zone appears next somewhere, some time, or is not seen again: one of these,
with the odds and transit times that prediction uses (`camtopod.predict.predictor`; the thesis has
the times in 4.5, and a Markov chain over cameras for the odds in 4.6). An object that appears has
left some zone before, or comes from outside, which happens at a steady rate. All as logarithms, so
that they add up with those of other evidence:

    gate(...)      ln of 1/s   who left here then appears next there then
    gate_new(...)  ln of 1/s   somebody from outside appears there then
    gate_gone(...) ln of 1     who left here then is not to be seen (yet)

``gate - gate_new - gate_gone`` is the log odds of an exit and an entry being one object's against
their being two objects'; `Gate.affinity` has them for many. The matching with the largest sum is
the likeliest of all matchings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.client.errors import zone_at, zones_of
from camtopod.predict import Hazards, Predictor, Surroundings
from camtopod.records import Event, Kind, Topology
from camtopod.topology import block_of

OUTSIDE_SHARE_MIN = 0.05
"""Zones with a smaller share of entries from outside do not tell how long was learned from."""


class _Onward(NamedTuple):
    """Where who left a zone appears next; all of it sums to 1."""

    targets: list[int]
    chance: Floats
    """(targets, bins) probability of appearing there in each lag bin."""
    delay: Floats
    """(targets,) seconds to add to the lags of the bins, for long ways."""
    gone: float
    """Probability of not being seen again."""
    began: _Began | None = None
    """How the passage that ended began, where it is known, ..."""
    early: NDArray[np.float64] | None = None
    """... and (targets,) by how much what the entry foretells of before the exit counts beside the
    rest.
    """


class _Began(NamedTuple):
    """How a passage began: the zone of entry, and how many seconds before its exit."""

    zone: int
    stay: float


class Gate:
    """The log-priors of one version of the topology. Does not change; any thread may ask.

    Times are seconds since the epoch by the clock of the camera where they were taken, as in
    events; what the version knows of the clocks is taken into account. While little has been
    learned the odds are too sure, as predictions are. Without a daemon: ``Gate(topology)`` of a
    topology read from a file.
    """

    def __init__(self, topology: Topology, predictor: Predictor | None = None) -> None:
        """``predictor``: one over the same topology, where there is one already."""
        self.topology = topology
        self._predictor = predictor or Predictor(topology)
        self._hazards = Hazards(topology)
        self._surroundings = Surroundings(topology)
        self._ahead = {camera.id: camera.clock_offset for camera in topology.cameras}
        self._new = self._rates_from_outside()

    def gate(
        self,
        from_zone: str,
        t_exit: float,
        to_camera: str,
        t_entry: float,
        to_zone: str | None = None,
    ) -> float:
        """ln of the density, in 1/s of ``t_entry``, with which an object that left ``from_zone`` at
        ``t_exit`` appears next at ``to_camera`` at ``t_entry``; at ``to_zone`` of it, if given.

        Over all times the density sums to the probability of appearing there next; over all
        cameras, too, to 1 less that of not being seen again. It is a step function: constant within
        a bin of some percent of the lag. Where views overlap, ``t_entry`` may be before ``t_exit``.
        -inf where no way has been learned that takes this long: for the topology, not for ever.
        Raises ValueError for times that are not finite numbers.

        ``from_zone`` is a zone's id (``lobby/1``). Raises `UnknownPlace`, a KeyError, for a zone or
        camera that this version does not have: zones come and go with versions, so of events better
        take `affinity`, which finds them by their positions.
        """
        source = zone_at(self.topology, from_zone)
        to = self._zones(to_camera, to_zone)
        onward = self._onward(source)
        lag = (t_entry - self._ahead[to_camera]) - (
            t_exit - self._ahead[self.topology.zones[source].camera]
        )
        if not math.isfinite(lag):
            raise ValueError(f"t_exit {t_exit} and t_entry {t_entry}: finite numbers of seconds")
        zones = np.array(to, np.intp)
        return float(
            np.logaddexp.reduce(self._log_density(onward, zones, np.full(len(zones), lag)))
        )

    def gate_new(self, to_camera: str, to_zone: str | None = None) -> float:
        """ln of the rate, in 1/s, at which objects from outside appear at a camera, or at a zone of
        it: those that have not left another zone before, false ones among them. Raises
        `UnknownPlace`, a KeyError.

        One figure for all times: the mean over the window that was learned from.
        """
        return math.log(self._new[self._zones(to_camera, to_zone)].sum())

    def gate_gone(self, from_zone: str, seconds: float = math.inf) -> float:
        """ln of the probability that who left ``from_zone`` has not appeared anywhere ``seconds``
        later; without ``seconds``, that they are not seen again. Raises `UnknownPlace`, a KeyError;
        ValueError for what is no number.
        """
        if math.isnan(seconds):
            raise ValueError("seconds is not a number")
        return math.log(self._gone(self._onward(zone_at(self.topology, from_zone)), seconds))

    def affinity(
        self, exits: Sequence[Event], entries: Sequence[Event], now: float | None = None
    ) -> Floats:
        """Log odds (exits, entries), in nats, of each exit and entry being one object's against
        their being two objects'. Add the log likelihood ratios of your other evidence, appearance
        say, and match by

            rows, columns = scipy.optimize.linear_sum_assignment(np.maximum(odds, 0), maximize=True)

        of which those with odds above 0 are pairs: that is the likeliest matching as a whole.

        ``exits`` and ``entries`` are events as `TrackEvents` makes them, of all cameras in any
        order; zones are found by their positions. Where the entry of the passage that an exit ends
        is among the entries (the same camera and track), more is known: where it came from, and,
        where views overlap, how long after that entry it appears in other views. So give the
        entries of open tracks, too. ``now``: the time, seconds, up to which entries are known, so
        that who may still be under way is not taken for gone; the newest of the given times where
        it is not said. -inf: no way has been learned that takes this long; take ``np.maximum(odds,
        -20)`` where other evidence shall be able to overrule that. 0, so neither for nor against,
        where this version does not know a camera. Raises ValueError for an entry among the exits or
        an exit among the entries, or a time that is not a number.
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
        began = self._passages(exits, entries)
        for row, event in enumerate(exits):
            zone = self._predictor.zone_of(event)
            if zone is not None:
                onward = self._onward(zone, block_of(event.x, event.y), began[row])
                gone = math.log(self._gone(onward, until - left[row]))
                odds[row, known] = self._log_density(onward, to, came - left[row]) - new - gone
        return odds

    def _passages(self, exits: Sequence[Event], entries: Sequence[Event]) -> list[_Began | None]:
        """How the passage began that each of the ``exits`` ends, where its entry is among the
        ``entries``.
        """
        by_track: dict[tuple[str, str], list[Event]] = {}
        for entry in entries:
            if entry.track is not None:
                by_track.setdefault((entry.camera, str(entry.track)), []).append(entry)
        began: list[_Began | None] = []
        for event in exits:
            own = [
                entry
                for entry in by_track.get((event.camera, str(event.track)), [])
                if entry.t <= event.t
            ]
            newest = max(own, key=lambda entry: entry.t, default=None)
            zone = None if newest is None else self._predictor.zone_of(newest)
            began.append(
                None if newest is None or zone is None else _Began(zone, event.t - newest.t)
            )
        return began

    def _rates_from_outside(self) -> Floats:
        """(zones,) per second, such that as many are expected to have come as to have left before.

        The version has the rate of arrivals that no exit explains at all. Those that may as well
        have come by chance (`Outcome.doubt`) are gone, for their exits; so for their entries they
        are from outside.
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
        span = np.median(
            (entries - explained)[some] / rate[some]
        )  # seconds, of what was learned from
        balanced: Floats = np.maximum(rate, (entries - surely) / span)
        return balanced

    def _zones(self, camera: str, zone: str | None) -> list[int]:
        return (
            zones_of(self.topology, camera)
            if zone is None
            else [zone_at(self.topology, zone, camera)]
        )

    def _right(self, event: Event) -> float:
        """The event's time by right clocks."""
        return event.t - self._ahead[event.camera]

    def _onward(self, zone: int, block: int | None = None, began: _Began | None = None) -> _Onward:
        """As the predictor has it for an exit of which only the place and the passage are known,
        before anything has been seen since.
        """
        outcomes, bins = self._hazards.outcomes.get(zone), self._hazards.bins
        if outcomes is None:
            return _Onward([], np.zeros((0, bins.size)), np.zeros(0), 1.0)
        entry = None if began is None else began.zone
        likelier, leave = self._surroundings.multipliers(zone, outcomes, block, entry, None, 0.0)
        exposure = outcomes.exposure if began is None else self._hazards.exposed(began.stay)
        odds = (
            outcomes.hazard * bins.widths * outcomes.exposed(exposure) * np.array(likelier)[:, None]
        )
        early = (
            np.zeros(len(odds))
            if began is None
            else self._expected_early(outcomes.targets, began) * likelier
        )
        sure = 1.0 - outcomes.doubt
        every = odds.sum(axis=1) + early
        leave += float(outcomes.doubt @ every)
        total = leave + float(sure @ every)
        chance = odds * sure[:, None] / total
        if began is None:
            return _Onward(outcomes.targets, chance, outcomes.delay, leave / total)
        early_share = np.array(likelier) * sure / total
        return _Onward(outcomes.targets, chance, outcomes.delay, leave / total, began, early_share)

    def _expected_early(self, targets: list[int], began: _Began) -> Floats:
        """Appearances (targets,) that are expected before the exit by the entry alone."""
        bins = self._hazards.bins
        seconds = np.clip(began.stay - bins.edges[:-1], 0.0, bins.widths) * (bins.centres > 0)
        some = np.flatnonzero(seconds)
        expected = [
            self._hazards.rates_entered(
                began.zone, np.full(len(some), target, np.int32), bins.centres[some]
            )
            @ seconds[some]
            for target in targets
        ]
        return np.array(expected)

    def _gone(self, onward: _Onward, seconds: float) -> float:
        """Probability of not having been seen ``seconds`` after the exit."""
        bins = self._hazards.bins
        still = bins.edges[1:] + onward.delay[:, None] - seconds
        return onward.gone + float((onward.chance * np.clip(still / bins.widths, 0.0, 1.0)).sum())

    def _log_density(self, onward: _Onward, zones: NDArray[np.intp], lag: Floats) -> Floats:
        """ln of 1/s of appearing at zones (m,) with lags (m,) in seconds."""
        row_of = np.full(len(self.topology.zones), -1)
        row_of[onward.targets] = np.arange(len(onward.targets))
        row = row_of[zones]
        at = self._hazards.bins.index(lag - np.append(onward.delay, 0.0)[row])
        some = np.flatnonzero((row >= 0) & (at >= 0))
        density = np.zeros(len(zones))
        density[some] = onward.chance[row[some], at[some]] / self._hazards.bins.widths[at[some]]
        if onward.began is not None and onward.early is not None:
            before = some[lag[some] <= 0]
            entered = self._hazards.rates_entered(
                onward.began.zone, zones[before].astype(np.int32), onward.began.stay + lag[before]
            )
            density[before] += onward.early[row[before]] * entered
        with np.errstate(divide="ignore"):
            return np.log(density)


def _check(events: Sequence[Event], kind: Kind) -> None:
    for event in events:
        if event.kind != kind:
            raise ValueError(
                f"an {event.kind} of {event.camera} at {event.t} among what should be {kind} events"
            )
        if not math.isfinite(event.t):
            raise ValueError(
                f"an {event.kind} of {event.camera} at {event.t}: not a finite number of seconds"
            )
