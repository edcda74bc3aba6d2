"""Association priors for multi-camera tracking, from the learned topology.

An object that leaves a zone appears next at some zone after some lag, or is not seen again, with
the odds and transit times that prediction uses (thesis 4.5, 4.6). An object that appears has left
another zone before, or comes from outside, at a constant rate. All values are logarithms:

    gate(...)      ln of 1/s   an object that left there appears next here at this time
    gate_new(...)  ln of 1/s   an object from outside appears here
    gate_gone(...) ln of 1     an object that left there is not seen again, or not yet

``gate - gate_new - gate_gone`` is the log odds that an exit and an entry belong to one object
rather than to two. `Gate.affinity` computes it for many; the matching with the largest sum is the
most likely of all.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.client.errors import zone_at, zones_of
from camtopod.predict import ExitTable, Predictor
from camtopod.records import Event, Topology
from camtopod.topology import block_of

OUTSIDE_SHARE_MIN = 0.05
"""Smallest share of entries from outside at which a zone tells the duration of the window."""


class _Began(NamedTuple):
    """How a passage began: zone of entry and dwell time (seconds)."""

    zone: int
    stay: float


class _Onward(NamedTuple):
    """Where an object that left a zone appears next; all probabilities sum to 1.

    table: of the zone; None if nobody who leaves there is seen again.
    chance (targets, bins): probability of appearing at each target in each lag bin.
    gone: probability of not being seen again.
    early (targets,): factor of the rates before the exit that follow from the entry.
    """

    table: ExitTable | None
    chance: Floats
    gone: float
    early: Floats
    began: _Began | None


class Gate:
    """Association log-priors of one version of the topology. Immutable and thread-safe.

    Times are seconds since the epoch by the clock of the camera that reports the event; the
    version's clock offsets are applied. While little has been learned the odds are overconfident,
    as predictions are. To use a topology read from a file, without a daemon, call
    ``Gate(topology)``.
    """

    def __init__(self, topology: Topology, predictor: Predictor | None = None) -> None:
        """Prepare the tables; ``predictor`` is one over the same topology, if there is one."""
        self.topology = topology
        self.predictor = predictor or Predictor(topology)
        self._hazards = self.predictor.site.hazards
        self._ahead = self.predictor.site.clock_offset
        self._new = self._rates_from_outside()

    def gate(
        self,
        from_zone: str,
        t_exit: float,
        to_camera: str,
        t_entry: float,
        to_zone: str | None = None,
    ) -> float:
        """Return ln of the density (1/s) of a transition that ends at a camera at ``t_entry``.

        The object left ``from_zone`` at ``t_exit`` and appears next at ``to_camera``, or only at
        its zone ``to_zone`` if given.

        from_zone, to_zone: ids of zones (``lobby/1``).
        t_exit, t_entry: seconds since the epoch, each by its own camera's clock. Where views
            overlap, ``t_entry`` may be before ``t_exit``.

        Integrated over ``t_entry`` the density is the probability of appearing there next. It is a
        step function, constant within a bin of some percent of the lag, and -inf where this version
        of the topology has no link with this lag.

        Raises ValueError for times that are not finite; `UnknownPlace` (a KeyError) for a zone or
        camera that this version does not have. Zones come and go with versions: for events prefer
        `affinity`, which finds zones by position.
        """
        source = zone_at(self.topology, from_zone)
        zones = np.array(self._zones(to_camera, to_zone), np.intp)
        left = t_exit - self._ahead[self.topology.zones[source].camera]
        lag = t_entry - self._ahead[to_camera] - left
        if not math.isfinite(lag):
            raise ValueError(f"t_exit {t_exit} and t_entry {t_entry}: finite numbers of seconds")
        log_density = self._log_density(self._onward(source), zones, np.full(len(zones), lag))
        return float(np.logaddexp.reduce(log_density))

    def gate_new(self, to_camera: str, to_zone: str | None = None) -> float:
        """Return ln of the rate (1/s) at which objects from outside appear at a camera or zone.

        Objects from outside have not left another zone before; false detections count among them.
        The rate is constant in time: the mean over the window that was learned from. Raises
        `UnknownPlace` (a KeyError).
        """
        return math.log(self._new[self._zones(to_camera, to_zone)].sum())

    def gate_gone(self, from_zone: str, seconds: float = math.inf) -> float:
        """Return ln of the probability that an object is unseen ``seconds`` after leaving a zone.

        By default: that it is not seen again. Raises `UnknownPlace` (a KeyError); ValueError if
        ``seconds`` is NaN.
        """
        if math.isnan(seconds):
            raise ValueError("seconds is not a number")
        return math.log(self._gone(self._onward(zone_at(self.topology, from_zone)), seconds))

    def affinity(
        self, exits: Sequence[Event], entries: Sequence[Event], now: float | None = None
    ) -> Floats:
        """Return the log odds (exits, entries), in nats, that exit and entry belong to one object.

        The alternative is that they belong to two objects. Add the log likelihood ratios of other
        evidence, such as appearance, and match by

            rows, columns = scipy.optimize.linear_sum_assignment(np.maximum(odds, 0), maximize=True)

        Keep the pairs with odds above 0: this is the most likely matching as a whole.

        exits, entries: events as `TrackEvents` makes them, of all cameras, in any order. Zones are
            found by position. Include the entries of open tracks: if the entry of an exit's passage
            (same camera and track) is among the entries, the zone of entry and, where views
            overlap, the time since that entry improve the odds.
        now: corrected time (seconds) up to which entries are complete, so that objects still under
            way do not count as gone. Default: the newest of the given times.

        -inf means that no link has this lag; use ``np.maximum(odds, -20)`` if other evidence may
        overrule that. 0 means no information: this version does not know a camera.

        Raises ValueError for an entry among the exits, an exit among the entries, or an invalid
        time.
        """
        if now is not None and math.isnan(now):
            raise ValueError("now is not a number")
        for kind, events in (("exit", exits), ("entry", entries)):
            for one in events:
                if one.kind != kind or not math.isfinite(one.t):
                    what = f"an {one.kind} of {one.camera} at {one.t}"
                    raise ValueError(f"{what} among what should be {kind} events with times")

        # Zones and corrected times of the events.
        odds = np.zeros((len(exits), len(entries)))
        zones = [self.predictor.zone_of(entry) for entry in entries]
        known = np.array([k for k, zone in enumerate(zones) if zone is not None], np.intp)
        if not len(known):
            return odds
        to = np.array([zone for zone in zones if zone is not None], np.intp)
        came = np.array([self._corrected(entries[k]) for k in known])
        left = [self._corrected(event) for event in exits]
        until = max([*left, *came.tolist()]) if now is None else now

        # Row of each exit: the transition against leaving the site and an arrival from outside.
        new = np.log(self._new)[to]
        by_track = defaultdict(list)
        for entry in entries:
            if entry.track is not None:
                by_track[entry.camera, str(entry.track)].append(entry)
        for row, event in enumerate(exits):
            zone = self.predictor.zone_of(event)
            if zone is not None:
                began = self._began(event, by_track[event.camera, str(event.track)])
                onward = self._onward(zone, block_of(event.x, event.y), began)
                gone = math.log(self._gone(onward, until - left[row]))
                odds[row, known] = self._log_density(onward, to, came - left[row]) - new - gone
        return odds

    def _corrected(self, event: Event) -> float:
        """Return the corrected time of an event; minus infinity for an unknown camera."""
        return event.t - self._ahead.get(event.camera, math.inf)

    def _began(self, event: Event, entries: Sequence[Event]) -> _Began | None:
        """Return how the passage of an exit began: with the latest entry before it, if any.

        entries: those of its track.
        """
        before = [entry for entry in entries if entry.t <= event.t]
        newest = max(before, key=lambda entry: entry.t, default=event)
        zone = self.predictor.zone_of(newest)
        if newest is event or zone is None:
            return None
        return _Began(zone, event.t - newest.t)

    def _rates_from_outside(self) -> Floats:
        """Return the rate (zones,) of objects from outside, per second.

        The version has the rate of arrivals that no departure explains at all. Spurious transitions
        (`Outcome.doubt`) count as "left the site" for their exits, so their entries count as from
        outside. Expected arrivals then account for the entries counted.
        """
        rate = np.array(self._hazards.arrival_rate)
        entries = np.array([float(zone.entries) for zone in self.topology.zones])

        # Arrivals explained by departures, with and without spurious transitions.
        explained = np.zeros(len(rate))
        surely = np.zeros(len(rate))
        for zone, outcomes in self._hazards.outcomes.items():
            departures = self._hazards.departures[zone]
            chance = self._onward(zone).chance.sum(axis=1)
            np.add.at(explained, outcomes.targets, departures * outcomes.weight * outcomes.share)
            np.add.at(surely, outcomes.targets, departures * chance)

        # Duration of the window learned from, by zones with enough entries from outside.
        some = entries - explained > OUTSIDE_SHARE_MIN * entries
        if not some.any():
            return rate
        span = np.median((entries - explained)[some] / rate[some])  # seconds
        balanced: Floats = np.maximum(rate, (entries - surely) / span)
        return balanced

    def _zones(self, camera: str, zone: str | None) -> list[int]:
        """Return the zones (indices) of a camera, or the one zone given."""
        if zone is not None:
            return [zone_at(self.topology, zone, camera)]
        return zones_of(self.topology, camera)

    def _onward(self, zone: int, block: int | None = None, began: _Began | None = None) -> _Onward:
        """Return what is expected right after an exit of which only zone and passage are known.

        Equals the predictor's answer before anything has been seen since the exit.
        """
        table = self.predictor.site.table(zone)
        if table is None:
            return _Onward(None, np.zeros((0, 0)), 1.0, np.zeros(0), None)

        # Exposure, and arrivals before the exit; a known entry says more about both.
        outcomes = table.outcomes
        entry = None
        exposure = outcomes.exposure
        early = np.zeros(len(outcomes.targets))
        if began is not None:
            entry = began.zone
            exposure = self._hazards.exposure_of_passage(began.stay)
            early = self._expected_early(outcomes.targets, began) * table.is_first

        # Odds against leaving the site.
        likelier, leave = self.predictor.surroundings.multipliers(
            zone, outcomes, block, entry, None, 0.0
        )
        odds = outcomes.hazard * self._hazards.bins.widths * outcomes.exposure_by_row(exposure)
        odds *= likelier[:, None]

        # Spurious mass counts as "left the site".
        sure = 1.0 - outcomes.doubt
        every = odds.sum(axis=1) + early * likelier
        leave += float(outcomes.doubt @ every)
        chance, gone = outcomes.probabilities(sure * every, leave)
        scale = chance / np.maximum(every, 1e-300)
        return _Onward(table, odds * scale[:, None], gone, likelier * scale, began)

    def _expected_early(self, targets: list[int], began: _Began) -> Floats:
        """Return the arrivals (targets,) expected before the exit, given the entry alone."""
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
        """Return the probability of not having been seen ``seconds`` after the exit."""
        if onward.table is None:
            return onward.gone
        bins = self._hazards.bins
        still = bins.edges[1:] + onward.table.outcomes.delay[:, None] - seconds
        return onward.gone + float((onward.chance * np.clip(still / bins.widths, 0.0, 1.0)).sum())

    def _log_density(self, onward: _Onward, zones: NDArray[np.intp], lag: Floats) -> Floats:
        """Return ln of the density (1/s) of appearing at zones (m,) with lags (m,) in seconds."""
        # Density by lag bin.
        density = np.zeros(len(zones))
        if onward.table is not None:
            bins = self._hazards.bins
            row, which = onward.table.rows_of(zones)
            at = bins.index(lag[which] - onward.table.outcomes.delay[row])
            row, which, at = row[at >= 0], which[at >= 0], at[at >= 0]
            np.add.at(density, which, onward.chance[row, at] / bins.widths[at])

            # Before the exit, the rates that follow from the entry are added.
            if onward.began is not None:
                kept = (lag[which] <= 0) & onward.table.is_first[row]
                row = row[kept]
                before = which[kept]
                entered = self._hazards.rates_entered(
                    onward.began.zone,
                    zones[before].astype(np.int32),
                    onward.began.stay + lag[before],
                )
                density[before] += onward.early[row] * entered
        with np.errstate(divide="ignore"):
            return np.log(density)
