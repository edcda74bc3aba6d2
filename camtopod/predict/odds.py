"""Odds of where and when the object of an exit appears next, given the events observed so far.

The *targets* of an exit are the zones where its object may appear next. The odds are masses by
target and lag bin, relative to the probability of leaving the site (`find_odds`): the hazard in lag
bins that are still to come, less if the target's camera may have stopped reporting; and for each
observed arrival the hazard of the object over the rate of all other causes of the arrival.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Bools, Floats, Ints, Rows
from camtopod.predict.hazards import Hazards, model_of
from camtopod.predict.labels import UNKNOWN_LABEL, Labels
from camtopod.predict.open_passages import UNKNOWN, Passage
from camtopod.predict.outcomes import Outcomes
from camtopod.predict.time_windows import (
    Pace,
    quantiles,
    scale_lags,
    unknown_share,
    windows_at_pace,
)
from camtopod.records import Topology, Zone

RATE_MIN = 1e-6
"""Lower bound on the rate (1/s) of the other causes of an arrival."""


class Query(NamedTuple):
    """A question: an exit, and the moment at which its object's next appearance is asked for."""

    zone: int
    """Index of the zone of the exit."""
    t: float
    """Corrected time of the exit, seconds."""
    passage: Passage | None
    """The passage that ends with the exit; None if it is not known."""
    is_observed: bool
    """True if the exit has been observed, so that it is among the known causes of arrivals."""
    elapsed: float = 0.0
    """Seconds from the exit to the moment of the question; 0 means just before the exit."""
    slowness: float = 1.0
    """Expected transit times of the object over the usual ones; applies to lags after the exit."""
    label: int = UNKNOWN_LABEL
    """Number of the object's label."""

    @property
    def began(self) -> float:
        """Corrected time at which the passage began, seconds; minus infinity if unknown."""
        return (self.passage or UNKNOWN).t

    @property
    def dwell(self) -> float | None:
        """Duration of the passage, seconds; None if unknown."""
        return None if self.passage is None else self.t - self.passage.t


class SeenArrivals(NamedTuple):
    """The n observed arrivals that may be of the object of a query."""

    zone: Ints
    """(n,) index of the zone of each arrival."""
    t: Floats
    """(n,) corrected time, seconds."""
    rate: Floats
    """(n,) rate (1/s) of all known causes of the arrival, the object of the query included."""
    before: Bools
    """(n,) True for arrivals before the exit."""
    label: Ints
    """(n,) number of the label."""
    remembered: float = -math.inf
    """Time, in seconds after the exit, since which all arrivals are remembered."""

    def take(self, rows: Rows) -> SeenArrivals:
        """Return the arrivals given by their rows."""
        return SeenArrivals(
            self.zone[rows],
            self.t[rows],
            self.rate[rows],
            self.before[rows],
            self.label[rows],
            self.remembered,
        )


class Odds(NamedTuple):
    """Odds of the targets of one zone."""

    mass: Floats
    """(targets, bins) odds by target and lag bin, relative to those of leaving the site."""
    edges: Floats
    """(bins + 1,) edges of the lag bins in seconds, for an object of the query's slowness."""

    def by_target(self) -> Floats:
        """Return the odds (targets,) of each target."""
        total: Floats = self.mass.sum(axis=1)
        return total


class ExitTable:
    """Figures of a topology version about objects that leave at one zone.

    site: all zones of the version.
    zone: index of the zone.
    """

    def __init__(self, site: Site, zone: int) -> None:
        outcomes = site.hazards.outcomes[zone]
        self.zone = zone
        self.outcomes: Outcomes = outcomes
        self.targets = [site.zones[target] for target in outcomes.targets]
        self.target_cameras = site.camera_of[outcomes.targets]
        """(targets,) number of each target's camera."""
        self.transitions = outcomes.share * site.hazards.departures[zone]
        """(targets,) expected transitions that the hazards were learned from."""
        self.is_first = np.zeros(len(outcomes.targets), np.bool_)
        """(rows,) True for the first row of each target."""
        self.is_first[np.unique(outcomes.targets, return_index=True)[1]] = True

        # Clocks of the targets relative to that of this camera.
        offsets = site.offset_of[outcomes.targets] - site.offset_of[zone]
        self.report_shift = offsets + outcomes.delay
        """(targets, seconds) to be added to a lag to get the difference of the event times of exit
        and arrival, each by its camera's clock, after which an arrival counts as reported.
        """
        self.window_shift = np.where(site.is_corrected, 0.0, offsets) + outcomes.delay
        """(targets, seconds) to be added to a lag to get the lag that is published."""

    def windows(self, rows: Rows, odds: Odds, pace: Pace | None) -> list[list[float]]:
        """Return the time window of each of the targets ``rows``: quantiles of the published lag.

        pace: expected pace of the object; None if its lags are of its own pace already.
        """
        lags = quantiles(odds.mass[rows], odds.edges)
        lags = windows_at_pace(pace, lags, self.transitions[rows])
        windows: list[list[float]] = np.round(lags + self.window_shift[rows, None], 3).tolist()
        return windows


class Site:
    """The zones of a topology version, with their cameras, clocks and hazards.

    The `ExitTable` of a zone is made at its first exit. It does not refer to the site: without
    reference cycles the memory of a version is free as soon as the version is no longer used.
    """

    def __init__(self, topology: Topology, hazards: Hazards) -> None:
        model = model_of(topology)
        self.zones: list[Zone] = topology.zones
        self.hazards = hazards
        self.labels = Labels(topology)
        self._tables: dict[int, ExitTable] = {}

        # Clocks.
        self.is_corrected = model.clocks_corrected
        """True if published lags are between corrected times."""
        self.clock_offset = {camera.id: camera.clock_offset for camera in topology.cameras}
        """Clock offset of each camera, seconds."""
        offsets = self.clock_offset.values()
        self.offset_range = max(offsets, default=0.0) - min(offsets, default=0.0)
        """Largest difference between two clocks, seconds."""
        self.offset_of = np.array([self.clock_offset.get(zone.camera, 0.0) for zone in self.zones])
        """(zones, seconds) clock offset of each zone's camera."""

        # Cameras that have zones.
        self.cameras = list(dict.fromkeys(zone.camera for zone in self.zones))
        number = {camera: k for k, camera in enumerate(self.cameras)}
        self.camera_of = np.array([number[zone.camera] for zone in self.zones], np.intp)
        """(zones,) number of each zone's camera."""
        share = {row.camera: row.share for row in model.cameras}
        self.event_share = np.array([share.get(camera, 0.0) for camera in self.cameras])
        """(cameras,) share of each camera in all events of the site."""

    def table(self, zone: int) -> ExitTable | None:
        """Return the table of a zone, given by its index; None if the zone has no targets."""
        if zone not in self._tables and zone in self.hazards.outcomes:
            self._tables[zone] = ExitTable(self, zone)
        return self._tables.get(zone)


def find_odds(
    query: Query, site: Site, table: ExitTable, is_alive: Floats, seen: SeenArrivals
) -> Odds:
    """Return the odds of where and when the object of a query appears next.

    site: all zones of the version.
    table: the table of the zone of the exit.
    is_alive (targets,): probability that each target's camera still reports.
    seen: observed arrivals that may be of the object.
    """
    hazards = site.hazards
    outcomes = table.outcomes

    # Exposure, and the lag bins of an object of this slowness.
    exposure = (
        outcomes.exposure if query.dwell is None else hazards.exposure_of_passage(query.dwell)
    )
    exposure = outcomes.exposure_by_row(exposure)
    edges = scale_lags(hazards.bins.edges, query.slowness)

    # Mass of arrivals that would not be observed yet. At the exit, a bin counts as a whole if any
    # arrival in it would be reported later.
    mass = outcomes.hazard * hazards.bins.widths * exposure
    if query.elapsed:
        mass *= unknown_share(edges, query.elapsed, seen.remembered, table.report_shift)
    else:
        mass *= edges[1:] > -table.report_shift[:, None]
    mass *= is_alive[:, None]

    # Observed arrivals at targets, at lags that have a bin.
    which, row = hazards.rows_to(query.zone, seen.zone)
    lag = seen.t[which] - query.t - outcomes.delay[row]
    at = hazards.bins.index(scale_lags(lag, 1.0 / query.slowness))
    fits = np.flatnonzero(at >= 0)
    if not len(fits):
        return Odds(mass, edges)
    seen = seen.take(which[fits])
    row = row[fits]
    at = at[fits]

    # The mass of each is the object's hazard over the rate of all other causes.
    hazard = outcomes.hazard[row, at] * exposure[row, at]
    hazard *= hazards.bins.widths[at] / (edges[at + 1] - edges[at])
    entered = np.zeros(len(row))
    if query.passage is not None:
        entered = hazards.rates_entered(query.passage.entry, seen.zone, seen.t - query.passage.t)
    others = seen.rate - own_rate(query, site, seen, entered)
    hazard += entered * seen.before * table.is_first[row]
    hazard *= site.labels.agreement(query.label, seen.label, seen.zone)
    np.add.at(mass, (row, at), hazard / np.maximum(others, RATE_MIN))
    return Odds(mass, edges)


def own_rate(query: Query, site: Site, seen: SeenArrivals, entered: Floats) -> Floats:
    """Return the part (n, 1/s) that the object of the query has in the rate of each seen arrival.

    entered (n, 1/s): rate of the arrivals by the entry kernels of the object's entry.

    While its passage is open, the object is a cause of arrivals in two ways: by its zone of entry,
    and as an object in view. When its exit is observed, the hazard of the exit takes the place of
    the latter (`Predictor`). This part is subtracted to get the rate of all other causes.
    """
    # What follows from the entry, by the label that the entry had.
    label = (query.passage or UNKNOWN).label
    entered = entered * site.labels.agreement(label, seen.label, seen.zone)
    if query.is_observed:
        rate = site.hazards.rates_from(query.zone, seen.zone, seen.t - query.t)
        rate *= site.labels.agreement(query.label, seen.label, seen.zone)
        return rate + entered * seen.before
    if query.passage is None:
        return np.zeros(len(seen.t))

    # The passage is still open, also for arrivals after the exit, but in other views only.
    in_view = site.hazards.rates_before_exit(site.zones[query.zone].camera, seen.zone)
    in_view = in_view * site.labels.agreement(label, seen.label, seen.zone)
    in_other_views = site.camera_of[seen.zone] != site.camera_of[query.zone]
    return np.where(in_other_views, entered + in_view, 0.0)
