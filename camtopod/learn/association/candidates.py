"""Candidates: every departure and arrival that may be of one object, within the range of lags.

`find_candidates` lists them in a `Candidates` table, ordered by arrival: M candidates, each of a
*pair* of zones (zone of departure, zone of arrival), of which there are P. This module also
computes the first hazards of a fit from the histogram of lags of each pair (`initial_hazards`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints, Rows, Singles, ranges_in_parts, row_slices
from camtopod.learn.association.problem import Problem
from camtopod.learn.lags import excess_over_null
from camtopod.topology import LagBins

CANDIDATES_AT_ONCE = 1 << 15
"""Number of candidates processed together, of possibly millions. Intermediate results of this size
stay in the processor's cache and need little memory.
"""


class Candidates(NamedTuple):
    """M candidates, ordered by arrival, and the P pairs of zones that they belong to."""

    departure: Indices
    """(M,) row in the table of departures."""
    arrival: Indices
    """(M,) row in the table of arrivals, ascending."""
    pair: Ints
    """(M,) number of the pair of zones, 0 to P - 1."""
    lag: Singles
    """(M,) seconds from departure to arrival."""
    source: Ints
    """(P,) zone of departure of each pair."""
    target: Ints
    """(P,) zone of arrival of each pair."""

    def rows(self, mask: NDArray[np.bool_]) -> Candidates:
        """Return the candidates of a mask; pairs of zones keep their numbers."""
        return self._replace(
            departure=self.departure[mask],
            arrival=self.arrival[mask],
            pair=self.pair[mask],
            lag=self.lag[mask],
        )

    def take(self, mask: NDArray[np.bool_]) -> Candidates:
        """Return the candidates of a mask, and only the pairs of zones that have any."""
        rows = np.flatnonzero(mask)
        present = np.bincount(self.pair[rows], minlength=len(self.source)) > 0
        number = np.cumsum(present, dtype=np.int32) - 1
        return Candidates(
            self.departure[rows],
            self.arrival[rows],
            number[self.pair[rows]],
            self.lag[rows],
            self.source[present],
            self.target[present],
        )


def newest_within_limit(problem: Problem, candidates_max: int) -> Problem:
    """Return a problem with only the newest departures and arrivals, within a limit of candidates.

    candidates_max: the limit; every departure and arrival within the range of lags counts.

    Departures and arrivals are cut at the same moment: a departure whose arrivals were left out
    would look like one of an object that left the site. Of arrivals at one moment all are kept or
    none.
    """
    # Count candidates back from the newest arrival.
    departures = problem.departures
    arrivals = problem.arrivals
    low, high = departures_in_reach(departures.t, arrivals.t, problem.bins)
    count = int(np.searchsorted(np.cumsum((high - low)[::-1]), candidates_max, side="right"))
    if count == len(arrivals.t):
        return problem

    # Cut both at the first arrival that is kept.
    late = arrivals.t > arrivals.t[-count - 1]
    first = arrivals.t[late].min(initial=np.inf)
    return problem._replace(
        departures=departures.take(departures.t >= first, late), arrivals=arrivals.take(late)
    )


def departures_in_reach(
    departure_times: Floats, arrival_times: Floats, bins: LagBins
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the range of departures within the lags of each arrival: first, and one past the last.

    departure_times (n,): times of departures in seconds, ascending.
    arrival_times (m,): times of arrivals in seconds, ascending.

    Both results are rows of departures, (m,).
    """
    low = np.searchsorted(departure_times, arrival_times - bins.lag_max, side="left")
    high = np.searchsorted(departure_times, arrival_times - bins.lag_min, side="right")
    return low, high


def reach(problem: Problem) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the range of departures within the lags of each arrival, (m,), or their delayed lags.

    The two results are as those of `departures_in_reach`.
    """
    departures, arrivals, bins, *_ = problem
    low, high = departures_in_reach(departures.t, arrivals.t, bins)
    if problem.ranges is not None:
        longest = bins.lag_max + problem.ranges.delay.max()
        low = np.searchsorted(departures.t, arrivals.t - longest, side="left")
    return low, high


def possible(problem: Problem, departure: Rows, arrival: Rows, lag: Floats) -> NDArray[np.bool_]:
    """Return a mask (n,) of the departures and arrivals that may be of one object.

    departure, arrival (n,): rows of the departures and of the arrivals.
    lag (n, seconds): from the departure to the arrival.

    A negative lag is possible only where two views see the object at once: the cameras must differ,
    and the passage that ends with the departure must have begun before the arrival. Of two passages
    that begin at the same instant, the one that ends first counts as the earlier.
    """
    departures, arrivals, bins, *_ = problem
    lag_in_range = lag
    if problem.ranges is not None:
        lag_in_range = lag - problem.delays(departures.zone[departure], arrivals.zone[arrival])
    result = (lag_in_range >= bins.lag_min) & (lag_in_range <= bins.lag_max)
    ahead = np.flatnonzero(lag <= 0)
    departure_ahead = departure[ahead]
    arrival_ahead = arrival[ahead]
    arrival_t = arrivals.t[arrival_ahead]
    since = departures.since[departure_ahead]
    elsewhere = departures.camera[departure_ahead] != arrivals.camera[arrival_ahead]
    result[ahead] &= elsewhere & (arrival_t >= since)

    # For each arrival, the departure that ends the passage that begins with it; if unknown, the
    # number of departures.
    ties = np.flatnonzero(elsewhere & (arrival_t == since))
    if len(ties):
        ends = np.full(len(arrivals.t) + 1, len(departures.t), np.intp)
        ends[departures.own] = np.arange(len(departures.t))
        result[ahead[ties]] &= departure_ahead[ties] < ends[arrival_ahead[ties]]
    return result


def find_candidates(problem: Problem) -> Candidates:
    """Return all candidates of a problem."""
    departures, arrivals, _, zones, *_ = problem
    low, high = reach(problem)

    # List the departures within the lags of some arrivals at a time.
    no_rows = np.zeros(0, np.int32)
    parts = [(no_rows, no_rows, np.zeros(0, np.float32))]
    for arrival, departure in ranges_in_parts(low, high - low, CANDIDATES_AT_ONCE):
        lag = arrivals.t[arrival] - departures.t[departure]
        possible_rows = np.flatnonzero(possible(problem, departure, arrival, lag))
        rows = departure[possible_rows].astype(np.int32), arrival[possible_rows].astype(np.int32)
        parts.append((*rows, lag[possible_rows].astype(np.float32)))

    lefts, comes, lags = zip(*parts, strict=True)
    departure = np.concatenate(lefts)
    arrival = np.concatenate(comes)
    pair, source, target = number_pairs(departures.zone[departure], arrivals.zone[arrival], zones)
    return Candidates(departure, arrival, pair, np.concatenate(lags), source, target)


def initial_hazards(
    counts: Floats,
    rates: Floats,
    exposure: Floats,
    source: Ints,
    bins: LagBins,
    noise_sd: float,
    least: float,
) -> Floats:
    """Return initial hazards (P, bins), per second and exposed departure, written over ``counts``.

    A hazard is the rate at which objects that left the source of a pair appear at its target, by
    lag. The initial ones come from the excess of the lag histograms over the null model, or the
    share ``least`` of the histograms if that is more.

    counts (P, bins): observed candidates of each pair of zones by lag bin.
    rates (P, 1/s): rate of arrivals at the target of each pair under the null model.
    exposure (zones, bins): exposed departures (`exposure.exposures`).
    source (P,): zone of departure of each pair.
    noise_sd: as for `excess_over_null`.
    """
    for rows in row_slices(len(counts)):
        departure_seconds = exposure[source[rows]] * bins.widths
        expected = rates[rows, None] * departure_seconds
        above = np.maximum(excess_over_null(counts[rows], expected, noise_sd), least * counts[rows])
        np.divide(above, np.maximum(departure_seconds, bins.widths), out=counts[rows])
    return counts


def number_pairs(departure_zone: Ints, arrival_zone: Ints, zones: int) -> tuple[Ints, Ints, Ints]:
    """Number the pairs of zones that occur among M candidates, by source, then target.

    departure_zone, arrival_zone (M,): zones of departure and arrival of each candidate.
    zones: number of zones.

    Return the number of each candidate's pair (M,), and the source and the target of the pairs that
    occur, (P,) each.
    """
    key = departure_zone.astype(np.int64) * zones + arrival_zone
    present = np.unique(key)
    number = np.searchsorted(present, key)
    source, target = (ends.astype(np.int32) for ends in np.divmod(present, max(zones, 1)))
    return number.astype(np.int32), source, target


RESPONSIBILITY_MAX = 1.0 - 1e-6
"""Upper bound on a responsibility r where log(1 - r) is computed."""
