"""Candidates: every departure and arrival that may be one object, within the range of lags."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints, Singles, rows_together
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import LagBins, smoother

PAIR_TABLE_MAX = 20_000_000
"""Largest dense table over pairs of zones, entries."""
EXCESS_SMOOTHING_SD_BINS = (1.5, 3.0, 6.0)
CANDIDATES_AT_ONCE = 1 << 15
"""Worked on together where there may be millions: what is in between for so many stays in the
processor's cache, and takes no memory to speak of."""


class Candidates(NamedTuple):
    """Candidates (M,) in order of arrival: indices, pair of zones, lag in seconds; and the pairs'
    zones (P,).
    """

    departure: Indices
    arrival: Indices
    pair: Ints
    lag: Singles
    source: Ints
    target: Ints

    def take(self, kept: NDArray[np.bool_]) -> Candidates:
        """The candidates ``kept``, and of the pairs those that have any."""
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


def newest(
    departures: Departures, arrivals: Arrivals, bins: LagBins, candidates_max: int
) -> tuple[Departures, Arrivals]:
    """What left and came in the newest stretch of time that has at most ``candidates_max``
    candidates.

    Both are cut at the same moment: a departure whose arrivals were left out would look like one
    that leads nowhere.
    """
    low, high = in_reach(departures.t, arrivals.t, bins)
    kept = int(np.searchsorted(np.cumsum((high - low)[::-1]), candidates_max, side="right"))
    if kept == len(arrivals.t):
        return departures, arrivals
    first = arrivals.t[len(arrivals.t) - kept] if kept else np.inf
    late = arrivals.t >= first
    return departures.take(departures.t >= first, late), arrivals.take(late)


def in_reach(
    left: Floats, came: Floats, bins: LagBins
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last-but-one departure within the lags of each arrival: of times ``left`` and
    ``came``, ascending.
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
    """Departure, index into ``mine`` (n,) and lag in seconds of all candidates of the arrivals
    ``mine``; departures only ``among`` these (ascending), if given. In parts of about ``at_once``
    pairs in reach, so that memory does not grow with their number.
    """
    t, came = departures.t if among is None else departures.t[among], arrivals.t[mine]
    low, high = in_reach(t, came, bins)
    reached = np.concatenate(([0], np.cumsum(high - low)))
    ends = np.full(
        len(arrivals.t) + 1, len(departures.t), np.intp
    )  # where the passage of each arrival ends
    ends[departures.own[::-1]] = np.arange(len(departures.t))[
        ::-1
    ]  # delayed departures come after their own
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

        # A negative lag means two views at once: another camera, and the passage here had begun. Of
        # two passages that begin at the same instant the one that ends first comes first.
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
    """All candidates."""
    low, high = in_reach(departures.t, arrivals.t, bins)
    most = int((high - low).sum())
    # Of what is not written to no memory is taken: there are fewer than are in reach.
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


def together(arrival: Indices) -> list[slice]:
    """The candidates (M,) in order of ``arrival``, about `CANDIDATES_AT_ONCE` in each: all of an
    arrival together.
    """
    parts, first = [], 0
    while first < len(arrival):
        last = arrival[min(first + CANDIDATES_AT_ONCE, len(arrival)) - 1]
        stop = int(np.searchsorted(arrival, last, side="right"))
        parts.append(slice(first, stop))
        first = stop
    return parts


class Runs(NamedTuple):
    """The arrivals (m,) of some candidates in their order: the ``first`` candidate of each, and how
    many it has.
    """

    arrival: Indices
    first: NDArray[np.intp]
    candidates: NDArray[np.intp]


def runs_of(arrival: Indices) -> Runs:
    """The runs of some candidates (n,), ascending by ``arrival``."""
    first = np.flatnonzero(np.diff(arrival, prepend=-1))
    return Runs(arrival[first], first, np.diff(first, append=len(arrival)))


def excess(seen: Floats, chance: Floats, bins: LagBins, noise_sd: float) -> Floats:
    """What a histogram of lags (P, bins) has above chance and ``noise_sd`` standard deviations of
    it, smoothed, at least 0.

    Cross-correlation (Makris, Ellis and Black 2004), at several widths, as some transit times are
    kept closely, others not.
    """
    result = np.zeros_like(seen)
    for sd_bins in EXCESS_SMOOTHING_SD_BINS:
        spread = smoother(bins.size, sd_bins)
        noise = np.sqrt(np.maximum(chance, 0.5) @ (spread**2).T)
        result = np.maximum(result, (seen - chance) @ spread.T - noise_sd * noise)
    return result


def first_hazards(
    seen: Floats,
    rates: Floats,
    exposure: Floats,
    source: Ints,
    bins: LagBins,
    noise_sd: float,
    least: float,
) -> Floats:
    """First hazards (P, bins), in the place of the ``seen`` (P, bins): their `excess`, at ``least``
    that share of them.

    ``rates`` (P,): of chance, 1/s; ``exposure`` (zones, bins), ``source`` (P,).
    """
    for rows in rows_together(len(seen)):
        exposed = exposure[source[rows]] * bins.widths
        chance = rates[rows, None] * exposed
        above = np.maximum(excess(seen[rows], chance, bins, noise_sd), least * seen[rows])
        np.divide(above, np.maximum(exposed, bins.widths), out=seen[rows])
    return seen


def number_pairs(left: Ints, came: Ints, zones: int) -> tuple[Ints, Ints, Ints]:
    """Pairs of zones numbered as they occur, by source, then target: the number of each (M,), and
    their zones (P,).
    """
    size = max(zones, 1)
    if zones * zones > PAIR_TABLE_MAX:
        present, number = np.unique(left.astype(np.int64) * zones + came, return_inverse=True)
        return (
            number.astype(np.int32),
            (present // size).astype(np.int32),
            (present % size).astype(np.int32),
        )
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
