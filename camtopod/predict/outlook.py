"""The outlook of an exit: where its object appears next and when, or that it is not seen again.

`outlook` is the one answer to this question; predictions, `camtopod.client.Gate`, walks and the
learner's self-score read it. The possible outcomes compete: the object appears at one of the zones
after some lag, or leaves the site. Their prior odds are the learned hazards of all pairs of zones.
They are changed by the exit's *context* (`contexts`), by *exposure* (a lag of -L is only possible
if the passage has lasted L), by *seen arrivals* (where views overlap, the object may already have
appeared), by *speed* (`time_windows`), and by *silent cameras*, which have probably stopped
reporting (`predictor_memory`). If the question is asked again later, outcomes that would have been
observed by then have lost their odds. What no hazard explains may appear `anywhere`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Bools, Floats, Ints, Rows
from camtopod.predict.labels import UNKNOWN_LABEL
from camtopod.predict.passages import UNKNOWN, Passage
from camtopod.predict.time_windows import (
    PassagePace,
    quantiles,
    scale_lags,
    unknown_share,
    windows_at_pace,
)
from camtopod.predict.version import ExitTable, PreparedVersion
from camtopod.topology import LEAVE_FLOOR

RATE_MIN = 1e-6
"""Lower bound on the rate (1/s) of the other causes of an arrival."""
NEXT_PROBABILITY_MIN = 1e-4
"""Least probability of an outcome; less likely ones are left out."""
OUTSIDE_SHARE_MIN = 0.05
"""Smallest share of entries from outside at which a zone tells the duration of the window."""


class Departure(NamedTuple):
    """An exit, and the moment at which its object's next appearance is asked for."""

    zone: int
    """Index of the zone of the exit."""
    t: float = 0.0
    """Corrected time of the exit, seconds."""
    passage: Passage | None = None
    """The passage that ends with the exit; None if it is not known."""
    block: int | None = None
    """Block of the image where the object left (`camtopod.topology.block_of`); None if unknown."""
    label: int = UNKNOWN_LABEL
    """Number of the object's label."""
    elapsed: float = 0.0
    """Seconds from the exit to the moment of the question; 0 means just before the exit."""

    @property
    def began(self) -> float:
        """Corrected time at which the passage began, seconds; minus infinity if unknown."""
        return (self.passage or UNKNOWN).t

    @property
    def dwell(self) -> float | None:
        """Duration of the passage, seconds; None if unknown."""
        return None if self.passage is None else self.t - self.passage.t


class Seen(NamedTuple):
    """What has been observed: n arrivals that may be of the object, and which cameras report."""

    zone: Ints
    """(n,) index of the zone of each arrival."""
    t: Floats
    """(n,) corrected time, seconds."""
    label: Ints
    """(n,) number of the label."""
    rate: Floats
    """(n,) rate (1/s) of all causes of the arrival but the object itself."""
    before: Bools
    """(n,) True for arrivals before the exit."""
    memory_start: float
    """Time, in seconds after the exit, since which all arrivals are remembered."""
    is_alive: Floats
    """(cameras,) probability that each camera still reports."""
    previous: str | None
    """Name of the camera where the object most probably was before; None if unknown."""
    sure: float
    """Probability that ``previous`` is right."""

    def take(self, rows: Rows) -> Seen:
        """Return the arrivals given by their rows."""
        return self._replace(
            zone=self.zone[rows],
            t=self.t[rows],
            rate=self.rate[rows],
            before=self.before[rows],
            label=self.label[rows],
        )


class Outlook(NamedTuple):
    """Where and when the object of an exit appears next; all probabilities sum to 1."""

    departure: Departure
    table: ExitTable | None
    """Of the zone of the exit; None if no object that leaves there is known to be seen again."""
    mass: Floats
    """(rows, bins) odds by row of the table and lag bin, at any scale within a row."""
    edges: Floats
    """(bins + 1, seconds) edges of the lag bins, for an object of this speed."""
    early: Floats
    """(rows,) odds of arrivals before the exit that follow from the entry alone."""
    chance: Floats
    """(rows,) probability of appearing at each row's target, by its opinion."""
    pace: PassagePace | None
    """Pace that windows are still to be adjusted to; None if the lags are of this speed already."""
    elsewhere: Floats
    """(cameras,) probability of appearing at each camera after no particular lag."""
    span: tuple[float, float]
    """Earliest and latest lag of that, seconds."""
    leave: float
    """Probability of not being seen again."""

    @property
    def unlinked(self) -> float:
        """Probability that the object leaves, or appears where no link tells."""
        return self.leave + float(self.elsewhere.sum())

    @property
    def scale(self) -> Floats:
        """(rows,) factor on ``mass`` that makes probabilities of it."""
        scale: Floats = self.chance / np.maximum(self.mass.sum(axis=1) + self.early, 1e-300)
        return scale

    def windows(self, rows: Rows) -> Floats:
        """Return the time windows (n, 3) of some rows: quantiles of the published lag, seconds."""
        assert self.table is not None
        lags = quantiles(self.mass[rows], self.edges)
        lags = windows_at_pace(self.pace, lags, self.table.transitions[rows])
        windows: Floats = lags + self.table.window_shift[rows, None]
        return windows

    def unseen(self, seconds: Floats, links_only: bool = False) -> Floats:
        """Return the probability (n,) of not having been seen by each of n lags in seconds.

        links_only: True to leave out what may appear anywhere, as if it were not seen again.
        """
        result = np.full(len(seconds), self.unlinked)
        if not links_only:
            first, last = self.span
            part = np.clip((seconds - first) / max(last - first, 1e-9), 0.0, 1.0)
            result -= part * float(self.elsewhere.sum())
        if self.table is not None:
            by_bin = self.mass * self.scale[:, None]
            delay = self.table.outcomes.delay
            for late in np.unique(delay):
                cumulative = np.append(0.0, by_bin[delay == late].sum(axis=0).cumsum())
                result += cumulative[-1] - np.interp(seconds - late, self.edges, cumulative)
        return result


def outlook(
    version: PreparedVersion, departure: Departure, observations: Seen | None = None
) -> Outlook:
    """Return the outlook of an exit.

    observations: what has been observed by the moment of the question; None for an exit that is
        seen alone, of which it is not known whether its object has appeared before.
    """
    zone, passage = departure.zone, departure.passage
    table = version.table(zone)
    if table is None:
        no_mass = np.zeros((0, version.hazards.bins.size))
        edges, no_rows = version.hazards.bins.edges, no_mass[:, 0]
        alone = Outlook(
            departure, None, no_mass, edges, no_rows, no_rows, None, no_rows, (0, 0), 1.0
        )
        return _with_elsewhere(version, alone)

    # The context multiplies the odds at the exit. Odds that may be spurious count as leaving the
    # site, from the exit on.
    outcomes = table.outcomes
    entry_passage = passage or UNKNOWN
    multiplier, leave = version.contexts.multipliers(
        zone,
        outcomes,
        departure.block,
        entry_passage.entry,
        None if observations is None else observations.previous,
        0.0 if observations is None else observations.sure,
    )
    before = observations
    if observations is not None and departure.elapsed:
        before = observations.take(np.flatnonzero(observations.before))
    mass, edges = _odds(version, table, departure._replace(elapsed=0.0), before)
    early = np.zeros(len(mass))
    if observations is None and passage is not None:
        early = _expected_early(version, outcomes.targets, departure) * table.is_first
    odds = multiplier * (mass.sum(axis=1) + early)
    leave += float(outcomes.doubt @ odds)

    # Odds at a later moment; their lag bins are those of the object's pace already.
    pace = version.paces.of_passage(entry_passage.entry, zone, departure.dwell)
    if departure.elapsed > 0.0:
        mass, edges = _odds(
            version, table, departure, observations, 1.0 if pace is None else pace.factor
        )
        odds = multiplier * mass.sum(axis=1)
        leave = max(leave, LEAVE_FLOOR)
        pace = None

    # Probabilities of the outcomes that are likely enough.
    chance, leave = outcomes.probabilities(odds * (1.0 - outcomes.doubt), leave)
    chance = np.where(chance >= NEXT_PROBABILITY_MIN, chance, 0.0)
    total = leave + float(chance.sum())
    chance, leave = chance / total, leave / total
    nowhere = np.zeros(0)
    link_outlook = Outlook(
        departure, table, mass, edges, early, chance, pace, nowhere, (0, 0), leave
    )
    return _with_elsewhere(version, link_outlook)


def _with_elsewhere(version: PreparedVersion, link_outlook: Outlook) -> Outlook:
    """Return an outlook in which a part of what leaves may appear anywhere, later than now."""
    anywhere, departure = version.anywhere, link_outlook.departure
    latest = version.hazards.bins.lag_max
    elapsed = min(departure.elapsed, latest)
    odds = 1.0 - elapsed / latest
    if anywhere.nobody_leaves:  # whenever it is asked for
        odds, elapsed, latest = 1.0, departure.elapsed, latest + departure.elapsed
    elsewhere = link_outlook.leave * odds * anywhere.shares(departure.zone)
    elsewhere[elsewhere < NEXT_PROBABILITY_MIN] = 0.0
    return link_outlook._replace(
        elsewhere=elsewhere,
        span=(elapsed, latest),
        leave=link_outlook.leave - float(elsewhere.sum()),
    )


def _odds(
    version: PreparedVersion,
    table: ExitTable,
    departure: Departure,
    observations: Seen | None,
    slowness: float = 1.0,
) -> tuple[Floats, Floats]:
    """Return the odds (rows, bins) by target and lag against leaving, and the edges of the bins.

    slowness: expected transit times of the object over the usual ones, after the exit.

    Odds are the hazard in lag bins that are still to come, less if the target's camera may have
    stopped reporting; and for each observed arrival the hazard of the object over the rate of all
    other causes of the arrival.
    """
    # Exposure, and the lag bins of an object of this slowness.
    hazards, outcomes = version.hazards, table.outcomes
    exposure = outcomes.exposure
    if departure.dwell is not None:
        exposure = hazards.exposure_of_passage(departure.dwell)
    exposure = outcomes.exposure_by_row(exposure)
    edges = scale_lags(hazards.bins.edges, slowness)
    mass = table.masses * exposure
    if observations is None:
        return mass, edges

    # Mass of arrivals that would not be observed yet.
    mass *= unknown_share(edges, departure.elapsed, observations.memory_start, table.report_shift)
    mass *= observations.is_alive[table.target_cameras][:, None]

    # Observed arrivals at targets, at lags that have a bin.
    event_row, row = hazards.rows_to(departure.zone, observations.zone)
    lag = observations.t[event_row] - departure.t - outcomes.delay[row]
    at = hazards.bins.index(scale_lags(lag, 1.0 / slowness))
    fits = np.flatnonzero(at >= 0)
    if not len(fits):
        return mass, edges
    observations, row, at = observations.take(event_row[fits]), row[fits], at[fits]

    # The mass of each is the object's hazard over the rate of all other causes.
    hazard = outcomes.hazard[row, at] * exposure[row, at]
    hazard *= hazards.bins.widths[at] / (edges[at + 1] - edges[at])
    entry_rates = np.zeros(len(row))
    if departure.passage is not None:
        since = observations.t - departure.passage.t
        entry_rates = hazards.rates_entered(departure.passage.entry, observations.zone, since)
    hazard += entry_rates * observations.before * table.is_first[row]
    hazard *= version.labels.agreement(departure.label, observations.label, observations.zone)
    np.add.at(mass, (row, at), hazard / np.maximum(observations.rate, RATE_MIN))
    return mass, edges


def _expected_early(version: PreparedVersion, targets: Rows, departure: Departure) -> Floats:
    """Return the arrivals (rows,) expected before the exit, given the entry alone."""
    bins, passage = version.hazards.bins, departure.passage
    assert passage is not None
    stay = departure.t - passage.t
    seconds = np.clip(stay - bins.edges[:-1], 0.0, bins.widths) * (bins.centres > 0)
    early_bins = np.flatnonzero(seconds)
    rates = version.hazards.rates_entered(
        passage.entry, targets[:, None], np.tile(bins.centres[early_bins], (len(targets), 1))
    )
    expected: Floats = rates @ seconds[early_bins]
    return expected


def log_density(
    version: PreparedVersion, alone: Outlook, zones: Rows, lag: Floats, links_only: bool = False
) -> Floats:
    """Return ln of the density (1/s) of appearing at zones (m,) with lags (m,) in seconds.

    alone: outlook of an exit that is seen alone.
    links_only: True to leave out what may appear anywhere.
    """
    # Density by lag bin.
    hazards, bins = version.hazards, version.hazards.bins
    density = np.zeros(len(zones))
    if alone.table is not None:
        event_row, row = hazards.rows_to(alone.departure.zone, zones)
        at = bins.index(lag[event_row] - alone.table.outcomes.delay[row])
        row, event_row, at = row[at >= 0], event_row[at >= 0], at[at >= 0]
        scale = alone.scale
        np.add.at(density, event_row, alone.mass[row, at] * scale[row] / bins.widths[at])

        # Before the exit, the rates that follow from the entry are added.
        departure = alone.departure
        if departure.passage is not None:
            mask = (lag[event_row] <= 0) & alone.table.is_first[row]
            row, before = row[mask], event_row[mask]
            since = departure.t - departure.passage.t + lag[before]
            entry_rates = hazards.rates_entered(
                departure.passage.entry, zones[before].astype(np.int32), since
            )
            density[before] += scale[row] * entry_rates

    # What may appear anywhere, after no particular lag.
    if not links_only:
        density += anywhere_rates(version, alone)[zones] * ((lag > 0) & (lag <= bins.lag_max))
    with np.errstate(divide="ignore"):
        return np.log(density)


def anywhere_rates(version: PreparedVersion, alone: Outlook) -> Floats:
    """Return the rates (zones, 1/s) of appearing after no particular lag, up to the longest one."""
    by_zone = alone.elsewhere[version.camera_of] * version.anywhere.within_camera
    rates: Floats = by_zone / version.hazards.bins.lag_max
    return rates


def outside_rates(version: PreparedVersion) -> Floats:
    """Return the rate (zones, 1/s) of entries that no link explains.

    The version has the rate of arrivals that no departure explains at all. Spurious transitions
    (`Outcomes.doubt`) count as "left the site" for their exits, so their entries count as from
    outside. Expected arrivals then account for the entries counted.
    """
    rate = np.array(version.hazards.arrival_rate)
    entries = np.array([float(zone.entries) for zone in version.zones])

    # Arrivals explained by departures, with and without spurious transitions.
    explained_arrivals, sure_arrivals = np.zeros((2, len(rate)))
    for zone, departures in enumerate(version.hazards.departures.tolist()):
        alone = outlook(version, Departure(zone))
        if alone.table is not None:
            outcomes = alone.table.outcomes
            np.add.at(
                explained_arrivals, outcomes.targets, departures * outcomes.weight * outcomes.share
            )
            np.add.at(sure_arrivals, outcomes.targets, departures * alone.chance)

    # Duration of the window learned from, by zones with enough entries from outside.
    is_clear = entries - explained_arrivals > OUTSIDE_SHARE_MIN * entries
    if not is_clear.any():
        return rate
    span = np.median((entries - explained_arrivals)[is_clear] / rate[is_clear])  # seconds
    result: Floats = np.maximum(rate, (entries - sure_arrivals) / span)
    return result
