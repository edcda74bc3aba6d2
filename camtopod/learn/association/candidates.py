"""Candidates: every departure and arrival that may be of one object, within the range of lags."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints, Singles, row_slices
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import LagBins, lag_smoothing_matrix

PAIR_TABLE_MAX = 20_000_000
"""Largest dense table over pairs of zones, entries; beyond, pairs are numbered by sorting."""
EXCESS_SMOOTHING_SD_BINS = (1.5, 3.0, 6.0)
"""Smoothing widths at which a lag histogram is compared with the null model, sd in lag bins."""
CANDIDATES_AT_ONCE = 1 << 15
"""Candidates worked on together, of possibly millions.

Intermediate results of this size stay in the processor's cache and need little memory.
"""


class Candidates(NamedTuple):
    """Candidates (M,), ordered by arrival, and the pairs of zones (P,) that they belong to."""

    departure: Indices
    """(M,) index of the departure."""
    arrival: Indices
    """(M,) index of the arrival, ascending."""
    pair: Ints
    """(M,) pair of zones, 0 to P - 1."""
    lag: Singles
    """(M,) seconds from departure to arrival."""
    source: Ints
    """(P,) zone of departure of each pair."""
    target: Ints
    """(P,) zone of arrival of each pair."""

    def take(self, kept: NDArray[np.bool_]) -> Candidates:
        """Return the candidates of the mask ``kept``, and only the pairs of zones that have any."""
        rows = np.flatnonzero(kept)
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


def newest_within_limit(
    departures: Departures, arrivals: Arrivals, bins: LagBins, candidates_max: int
) -> tuple[Departures, Arrivals]:
    """Return the newest departures and arrivals that make no more candidates than the limit.

    Both are cut at the same moment: a departure whose arrivals were left out would look like one
    that leads nowhere.

    candidates_max: limit of the candidates by range of lags alone.
    """
    # Count candidates back from the newest arrival.
    low, high = departures_in_reach(departures.t, arrivals.t, bins)
    kept = int(np.searchsorted(np.cumsum((high - low)[::-1]), candidates_max, side="right"))
    if kept == len(arrivals.t):
        return departures, arrivals

    # Cut both at the first arrival that is kept.
    first = arrivals.t[len(arrivals.t) - kept] if kept else np.inf
    late = arrivals.t >= first
    return departures.take(departures.t >= first, late), arrivals.take(late)


def departures_in_reach(
    left: Floats, came: Floats, bins: LagBins
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first departure within the lags of each arrival, and one past the last.

    left (n,), came (m,): times of departure and arrival in seconds, ascending.
    """
    low = np.searchsorted(left, came - bins.lag_max, side="left")
    high = np.searchsorted(left, came - bins.lag_min, side="right")
    return low, high


def possible(
    departures: Departures,
    arrivals: Arrivals,
    bins: LagBins,
    mine: NDArray[np.intp],
    among: NDArray[np.intp] | None = None,
    at_once: int = CANDIDATES_AT_ONCE,
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], Floats]]:
    """Yield the candidates of some arrivals: departure, index into ``mine``, lag in seconds.

    Each yield holds three arrays (n,), of about ``at_once`` pairs within the range of lags, so that
    memory does not grow with their number.

    mine: the arrivals, as indices.
    among: departures to consider, as ascending indices; None: all.
    """
    # Find the departures in reach of each arrival.
    t, came = departures.t if among is None else departures.t[among], arrivals.t[mine]
    low, high = departures_in_reach(t, came, bins)
    reached = np.concatenate(([0], np.cumsum(high - low)))

    # Departure that ends the passage begun by each arrival; n if unknown. Delayed copies come after
    # their originals, so in reverse order the original is written last.
    ends = np.full(len(arrivals.t) + 1, len(departures.t), np.intp)
    ends[departures.own[::-1]] = np.arange(len(departures.t))[::-1]

    # List the pairs of some arrivals at a time, at least one.
    first = 0
    while first < len(mine):
        stop = max(
            int(np.searchsorted(reached, reached[first] + at_once, side="right")) - 1, first + 1
        )
        n = high[first:stop] - low[first:stop]
        at = np.repeat(np.arange(first, stop), n)
        departure = np.arange(len(at)) + np.repeat(low[first:stop] - (np.cumsum(n) - n), n)
        if among is not None:
            departure = among[departure]

        lag = came[at] - departures.t[departure]
        possible = (lag >= bins.lag_min) & (lag <= bins.lag_max)

        # A negative lag means that both views see the object at once: the cameras must differ, and
        # the passage that ends with the departure must have begun before the arrival. Of two
        # passages that begin at the same instant, the one that ends first counts as the earlier.
        ahead = np.flatnonzero(lag <= 0)
        left, arrival = departure[ahead], mine[at[ahead]]
        then, since = arrivals.t[arrival], departures.since[left]
        begun = (then > since) | ((then == since) & (left < ends[arrival]))
        possible[ahead] &= begun & (departures.camera[left] != arrivals.camera[arrival])

        kept = np.flatnonzero(possible)
        yield departure[kept], at[kept], lag[kept]
        first = stop


def find_candidates(
    departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int
) -> Candidates:
    """Return all candidates."""
    low, high = departures_in_reach(departures.t, arrivals.t, bins)
    most = int((high - low).sum())

    # np.empty reserves address space only: pages that are never written cost no memory, and there
    # are fewer candidates than departures in reach.
    departure, arrival, lag = (
        np.empty(most, np.int32),
        np.empty(most, np.int32),
        np.empty(most, np.float32),
    )
    n = 0
    for left, came, apart in possible(departures, arrivals, bins, np.arange(len(arrivals.t))):
        here = slice(n, n := n + len(left))
        departure[here], arrival[here], lag[here] = left, came, apart
    departure, arrival, lag = departure[:n], arrival[:n], lag[:n]

    pair, source, target = number_pairs(departures.zone[departure], arrivals.zone[arrival], zones)
    return Candidates(departure, arrival, pair, lag, source, target)


def slices_by_arrival(arrival: Indices) -> list[slice]:
    """Return slices of the candidates, each with all candidates of its arrivals.

    A slice has about `CANDIDATES_AT_ONCE` candidates.

    arrival (M,): arrival of each candidate, ascending.
    """
    parts, first = [], 0
    while first < len(arrival):
        last = arrival[min(first + CANDIDATES_AT_ONCE, len(arrival)) - 1]
        stop = int(np.searchsorted(arrival, last, side="right"))
        parts.append(slice(first, stop))
        first = stop
    return parts


class ArrivalRuns(NamedTuple):
    """Runs of candidates that share an arrival, (m,) each."""

    arrival: Indices
    """(m,) the arrival of each run."""
    first: NDArray[np.intp]
    """(m,) the first candidate of each run."""
    candidates: NDArray[np.intp]
    """(m,) the number of candidates in each run."""


def runs_of(arrival: Indices) -> ArrivalRuns:
    """Return the runs of candidates (n,) that share an arrival; ``arrival`` must be ascending."""
    first = np.flatnonzero(np.diff(arrival, prepend=-1))
    return ArrivalRuns(arrival[first], first, np.diff(first, append=len(arrival)))


def excess_over_null(seen: Floats, chance: Floats, bins: LagBins, noise_sd: float) -> Floats:
    """Return how far lag histograms (P, bins) exceed the null model by more than noise, at least 0.

    Noise is ``noise_sd`` standard deviations of the smoothed null model. This is a
    cross-correlation (Makris, Ellis and Black 2004) at several widths, as the spread of transit
    times differs between links; the largest excess counts.

    seen, chance (P, bins): observed counts, and those expected under the null model.
    """
    result = np.zeros_like(seen)
    for sd_bins in EXCESS_SMOOTHING_SD_BINS:
        spread = lag_smoothing_matrix(bins.size, sd_bins)
        noise = np.sqrt(np.maximum(chance, 0.5) @ (spread**2).T)
        result = np.maximum(result, (seen - chance) @ spread.T - noise_sd * noise)
    return result


def initial_hazards(
    seen: Floats,
    rates: Floats,
    exposure: Floats,
    source: Ints,
    bins: LagBins,
    noise_sd: float,
    least: float,
) -> Floats:
    """Return initial hazards (P, bins), per second and exposed departure, written over ``seen``.

    They are the excess of the histograms over the null model, and at least the share ``least`` of
    the histograms themselves.

    seen (P, bins): candidates per lag bin.
    rates (P, 1/s): arrivals of each pair under the null model.
    exposure (zones, bins): exposed departures.
    source (P,): zone of departure of each pair.
    """
    for rows in row_slices(len(seen)):
        exposed = exposure[source[rows]] * bins.widths
        chance = rates[rows, None] * exposed
        above = np.maximum(excess_over_null(seen[rows], chance, bins, noise_sd), least * seen[rows])
        np.divide(above, np.maximum(exposed, bins.widths), out=seen[rows])
    return seen


def number_pairs(left: Ints, came: Ints, zones: int) -> tuple[Ints, Ints, Ints]:
    """Number the pairs of zones that occur, by source, then target.

    Returns the number of each candidate's pair (M,), and the source and target zones of the pairs
    (P,).

    left, came (M,): zones of departure and arrival.
    zones: number of zones.
    """
    size = max(zones, 1)

    # Too many pairs for a dense table: sort.
    if zones * zones > PAIR_TABLE_MAX:
        present, number = np.unique(left.astype(np.int64) * zones + came, return_inverse=True)
        return (
            number.astype(np.int32),
            (present // size).astype(np.int32),
            (present % size).astype(np.int32),
        )

    # Mark the pairs that occur in a dense table, number them, and look the numbers up.
    parts = [slice(k, k + CANDIDATES_AT_ONCE) for k in range(0, len(left), CANDIDATES_AT_ONCE)]
    table = np.zeros((zones, zones), np.int32)
    for part in parts:
        table[left[part], came[part]] = 1
    source, target = np.nonzero(table)
    table[source, target] = np.arange(len(source), dtype=np.int32)
    pair = np.empty(len(left), np.int32)
    for part in parts:
        pair[part] = table[left[part], came[part]]
    return pair, source.astype(np.int32), target.astype(np.int32)


RESPONSIBILITY_MAX = 1.0 - 1e-6
"""Responsibilities are clipped to this before log(1 - r) is taken."""
