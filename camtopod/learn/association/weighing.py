"""Weighing: the candidates of some pairs of zones, and which of them are probable."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, Indices, Ints, Rows, Singles, ranges, ranges_in_parts
from camtopod.learn.association.candidates import (
    CANDIDATES_AT_ONCE,
    Candidates,
    initial_hazards,
    possible,
    reach,
)
from camtopod.learn.association.em import START_FLOOR
from camtopod.learn.association.problem import Problem
from camtopod.learn.association.traffic_excess import Traffic
from camtopod.learn.lags import NOISE_SD
from camtopod.learn.limits import (
    EVENT_PAIRS_MAX,
    WEIGHED_AT_ONCE,
    ZONE_WEIGHED_AT_ONCE,
    arrivals_within,
)

LIKELY_MIN = 0.001
"""Probability up to which candidates are dropped or do not count."""
LIKELY_MAX = 3_000_000
LIKELY_PER_ARRIVAL = 16
"""Limits of the candidates kept for the joint fit, the likeliest: in all, or for each arrival if
that is more.
"""


class Block(NamedTuple):
    """Candidates of some arrivals, from `ZonePairs`: columns (n,), ordered by arrival and pair."""

    arrivals: Rows
    """(k,) rows of the arrivals."""
    at: Rows
    """Index of each candidate's arrival in `arrivals`."""
    departure: Rows
    """Row of each candidate's departure."""
    pair: Rows
    """Number of each candidate's pair of zones, as in `ZonePairs`."""
    lag: Floats
    """Seconds from the departure to the arrival."""


class ZonePairs:
    """Lists the candidates of some pairs of zones.

    source, target (P,): zones of departure and of arrival of the pairs, ordered by target.
    """

    def __init__(self, problem: Problem, source: Indices, target: Indices) -> None:
        departures, arrivals, _, zones, *_ = problem
        self.problem = problem
        self.source = source
        self.target = target
        self._first = np.searchsorted(target, np.arange(zones + 1))

        # Departures by zone, each as a row and as one number of zone and row.
        self._by_zone = np.argsort(departures.zone, kind="stable")
        self._key = departures.zone[self._by_zone] * np.int64(len(departures.t)) + self._by_zone
        self._low, self._high = reach(problem)

        # Expected number of candidates of each arrival.
        share = np.bincount(departures.zone, minlength=zones) / len(departures.t)
        share_sums = np.bincount(target, share[source], minlength=zones)
        self._reach = np.ceil((self._high - self._low) * share_sums[arrivals.zone]).astype(np.intp)

    def blocks(self, pairs_max: int) -> Iterator[Block]:
        """Yield the candidates, those of a few zones of arrival at a time.

        pairs_max: limit of the candidates; beyond it, the arrivals with the fewest are kept. A zone
            of arrival with more than `ZONE_WEIGHED_AT_ONCE` has several blocks.
        """
        # Arrivals by zone.
        zone = self.problem.arrivals.zone
        rows = np.argsort(zone, kind="stable")
        rows = rows[(arrivals_within(self._reach, pairs_max) & (self._reach > 0))[rows]]
        if not len(rows):
            return

        # Cut them into blocks.
        before = np.cumsum(self._reach[rows]) - self._reach[rows]
        before_zone = before[np.searchsorted(zone[rows], zone[rows])]
        part = (before - before_zone) // ZONE_WEIGHED_AT_ONCE
        block = np.stack((before_zone // WEIGHED_AT_ONCE, part))
        for arrivals in np.split(rows, np.flatnonzero(np.diff(block).any(axis=0)) + 1):
            yield self._of(arrivals)

    def _of(self, rows: Rows) -> Block:
        """Return the candidates of the arrivals ``rows``."""
        # Every arrival with every source of its zone, and the departures from there in reach.
        departures, arrivals, *_ = self.problem
        zone = arrivals.zone[rows]
        first = self._first[zone]
        at, pair = ranges(first, self._first[zone + 1] - first)
        nearest = self.source[pair] * np.int64(len(departures.t))
        low, high = (
            np.searchsorted(self._key, nearest + end[rows][at]) for end in (self._low, self._high)
        )

        # Those that are possible.
        parts = [(at[:0], at[:0], at[:0], arrivals.t[:0])]
        for number, position in ranges_in_parts(low, high - low, CANDIDATES_AT_ONCE):
            departure = self._by_zone[position]
            arrival = rows[at[number]]
            lag = arrivals.t[arrival] - departures.t[departure]
            index = np.flatnonzero(possible(self.problem, departure, arrival, lag))
            parts.append((at[number[index]], departure[index], pair[number[index]], lag[index]))
        return Block(rows, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def joined(blocks: Iterable[Block]) -> tuple[Ints, Ints, Ints, Singles]:
    """Return departure, arrival, pair and lag of all candidates, ordered by arrival and departure.

    The columns are those of `Candidates`.
    """
    no_rows = np.zeros(0, np.int32)
    parts = [(no_rows, no_rows, no_rows, np.zeros(0, np.float32))]
    for block in blocks:
        rows = block.departure, block.arrivals[block.at], block.pair
        departure, arrival, pair = (row.astype(np.int32) for row in rows)
        parts.append((departure, arrival, pair, block.lag.astype(np.float32)))
    departure, arrival, pair, lag = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(arrival.astype(np.int64) << 32 | departure)
    return departure[order], arrival[order], pair[order], lag[order]


def likely(traffic: Traffic, pairs: ZonePairs, block: Block) -> Block:
    """Weigh the candidates of a block, and return the probable ones."""
    _, arrivals, bins, *_ = pairs.problem
    first = int(block.pair.min(initial=len(pairs.source)))
    number = block.pair - first
    size = int(number.max(initial=-1)) + 1
    source, target = (ends[first : first + size] for ends in (pairs.source, pairs.target))
    cell = number * bins.size + bins.index(block.lag)

    # Initial hazards (pairs, bins): the excess over the null model. The arrivals of the block stand
    # for all arrivals at their zones.
    counts = np.bincount(cell, minlength=size * bins.size).reshape(-1, bins.size).astype(float)
    zones = len(traffic.exposure)
    arrival_counts = np.bincount(arrivals.zone, minlength=zones)
    block_counts = np.bincount(arrivals.zone[block.arrivals], minlength=zones)
    counts *= (arrival_counts / np.maximum(block_counts, 1))[target][:, None]
    rates = traffic.null_model.rates_of(source, target)
    exposure = traffic.exposure
    hazard = initial_hazards(counts, rates, exposure, source, bins, NOISE_SD, START_FLOOR)

    # Share each arrival among its candidates and the null model.
    weight = hazard.ravel()[cell]
    unrelated_rate = arrivals.rate[block.arrivals]
    total = unrelated_rate + np.bincount(block.at, weight, minlength=len(unrelated_rate))
    share = weight / total[block.at]

    # Drop improbable candidates.
    pairs_max = max(LIKELY_PER_ARRIVAL, LIKELY_MAX // len(arrivals.t)) * len(unrelated_rate)
    least = np.partition(share, -pairs_max)[-pairs_max] if len(share) > pairs_max else 0.0
    mask = share > max(least, LIKELY_MIN)
    at, departure, pair = block.at[mask], block.departure[mask], block.pair[mask]
    return Block(block.arrivals, at, departure, pair, block.lag[mask])


def candidates_of_pairs(problem: Problem, candidates: Candidates, pairs: Rows) -> Candidates:
    """Return all candidates of the given pairs of zones, probable or not, as evidence for links.

    Screened candidates are biased as evidence: those that remain of a pair have similar lags,
    whether there is a link or not. Beyond `EVENT_PAIRS_MAX` candidates, those of the arrivals
    with the fewest departures in reach are returned.

    candidates: the screened candidates, whose numbering of pairs is kept.
    pairs (k,): numbers of the pairs.
    """
    pairs = pairs[np.argsort(candidates.target[pairs], kind="stable")]
    zone_pairs = ZonePairs(problem, candidates.source[pairs], candidates.target[pairs])
    departure, arrival, pair, lag = joined(zone_pairs.blocks(EVENT_PAIRS_MAX))
    return candidates._replace(
        departure=departure, arrival=arrival, pair=pairs[pair].astype(np.int32), lag=lag
    )
