"""The outlook after one exit, seen alone: where its object appears next, when, or not at all.

`Transitions.after` puts the hazards, the context and the doubt of a version together for an exit of
which only zone, place and passage are known. It equals the predictor's answer before anything has
been observed since the exit. `walks` and `camtopod.client.gate` match exits with entries by it;
`Transitions.new` is the rate of entries that no exit explains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, Rows
from camtopod.predict.odds import ExitTable
from camtopod.predict.predictor import Predictor

OUTSIDE_SHARE_MIN = 0.05
"""Smallest share of entries from outside at which a zone tells the duration of the window."""


class Began(NamedTuple):
    """How a passage began: zone of entry and dwell time (seconds)."""

    zone: int
    stay: float


class Onward(NamedTuple):
    """Where an object that left a zone appears next; all probabilities sum to 1.

    table: of the zone; None if no object that leaves there is seen again.
    chance (rows, bins): probability of appearing at each target in each lag bin.
    scale (rows,): factor on `Hazards.rates` that makes densities of them, by the context.
    gone: probability of not being seen again.
    early (rows,): factor of the rates before the exit that follow from the entry.
    lost (zones,): probability of appearing at each zone after no particular lag; None for 0.
    """

    table: ExitTable | None
    chance: Floats
    scale: Floats
    gone: float
    early: Floats
    began: Began | None
    lost: Floats | None = None


class Transitions:
    """Transitions by one version of the topology, as the predictor reads it."""

    def __init__(self, predictor: Predictor) -> None:
        self._predictor = predictor
        self._hazards = predictor.site.hazards
        self.new = self._rates_from_outside()
        """(zones,) rate of objects from outside, 1/s."""

    def after(self, zone: int, block: int | None = None, began: Began | None = None) -> Onward:
        """Return the outlook right after an exit.

        zone: index of the zone of the exit.
        block: block of the image where the object left; None if unknown.
        began: how its passage began; None if unknown.
        """
        table = self._predictor.site.table(zone)
        if table is None:
            none = np.zeros(0)
            lost, gone = self._lost(zone, 1.0)
            return Onward(None, np.zeros((0, 0)), none, gone, none, None, lost)

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
        likelier, leave = self._predictor.surroundings.multipliers(
            zone, outcomes, block, entry, None, 0.0
        )
        odds = outcomes.hazard * self._hazards.bins.widths * outcomes.exposure_by_row(exposure)
        odds *= likelier[:, None]

        # Spurious mass counts as "left the site".
        sure = 1.0 - outcomes.doubt
        every = odds.sum(axis=1) + early * likelier
        leave += float(outcomes.doubt @ every)
        chance, gone = outcomes.probabilities(sure * every, leave)
        lost, gone = self._lost(zone, gone)
        scale = chance / np.maximum(every, 1e-300)
        chance_by_lag = odds * scale[:, None]
        weight = np.maximum(outcomes.weight, 1e-300)
        return Onward(
            table, chance_by_lag, likelier * scale / weight, gone, likelier * scale, began, lost
        )

    def lost_rates(self, onward: Onward) -> Floats | None:
        """Return the rates (zones, 1/s) of appearing after no particular lag; None for 0.

        They hold up to the longest lag.
        """
        return None if onward.lost is None else onward.lost / self._hazards.bins.lag_max

    def _lost(self, zone: int, gone: float) -> tuple[Floats | None, float]:
        """Return `Onward.lost`, and what it leaves of ``gone``, after an exit at a zone."""
        shares = self._predictor.anywhere.shares(zone)
        if shares is None:
            return None, gone
        return gone * shares, gone * (1.0 - float(shares.sum()))

    def gone(self, onward: Onward, seconds: float) -> float:
        """Return the probability of not having been seen ``seconds`` after the exit."""
        bins = self._hazards.bins
        gone = onward.gone
        if onward.lost is not None:
            gone += float(onward.lost.sum()) * min(max(1.0 - seconds / bins.lag_max, 0.0), 1.0)
        if onward.table is None:
            return gone
        still = bins.edges[1:] + onward.table.outcomes.delay[:, None] - seconds
        return gone + float((onward.chance * np.clip(still / bins.widths, 0.0, 1.0)).sum())

    def unseen(self, onward: Onward) -> list[float]:
        """Return the probability of not having been seen again by each edge of the lag bins."""
        bins = self._hazards.bins
        seen = np.zeros(bins.size + 1)
        if onward.lost is not None:
            seen += float(onward.lost.sum()) * np.clip(bins.edges / bins.lag_max, 0.0, 1.0)
        if onward.table is not None:
            delay = onward.table.outcomes.delay
            by_bin = onward.chance[delay == 0.0].sum(axis=0)
            seen[1:] += by_bin.cumsum()
            for row in np.flatnonzero(delay):
                reached = np.concatenate(([0.0], onward.chance[row].cumsum()))
                seen += np.interp(bins.edges - delay[row], bins.edges, reached)
        unseen: list[float] = (1.0 - seen).tolist()
        return unseen

    def log_density(self, onward: Onward, zones: Rows, lag: Floats) -> Floats:
        """Return ln of the density (1/s) of appearing at zones (m,) with lags (m,) in seconds."""
        # Density by lag bin.
        density = np.zeros(len(zones))
        if onward.table is not None:
            bins = self._hazards.bins
            which, row = self._hazards.rows_to(onward.table.zone, zones)
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
        if (rates := self.lost_rates(onward)) is not None:
            density += rates[zones] * ((lag > 0) & (lag <= self._hazards.bins.lag_max))
        with np.errstate(divide="ignore"):
            return np.log(density)

    def _expected_early(self, targets: list[int], began: Began) -> Floats:
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

    def _rates_from_outside(self) -> Floats:
        """Return the rate (zones,) of objects from outside, per second.

        The version has the rate of arrivals that no departure explains at all. Spurious transitions
        (`Outcome.doubt`) count as "left the site" for their exits, so their entries count as from
        outside. Expected arrivals then account for the entries counted.
        """
        rate = np.array(self._hazards.arrival_rate)
        entries = np.array([float(zone.entries) for zone in self._predictor.zones])

        # Arrivals explained by departures, with and without spurious transitions.
        explained = np.zeros(len(rate))
        surely = np.zeros(len(rate))
        for zone, outcomes in self._hazards.outcomes.items():
            departures = self._hazards.departures[zone]
            onward = self.after(zone)
            np.add.at(explained, outcomes.targets, departures * outcomes.weight * outcomes.share)
            np.add.at(surely, outcomes.targets, departures * onward.chance.sum(axis=1))

        # Duration of the window learned from, by zones with enough entries from outside.
        some = entries - explained > OUTSIDE_SHARE_MIN * entries
        if not some.any():
            return rate
        span = np.median((entries - explained)[some] / rate[some])  # seconds
        balanced: Floats = np.maximum(rate, (entries - surely) / span)
        return balanced
