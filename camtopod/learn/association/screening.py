"""Screening: select the candidates for the joint fit on sites with too many candidates for one fit.

On a large site two cheaper steps go before the joint fit (`CandidateScreen.find`):

* *Looks, now and then.* A look at a zone of arrival counts its arrivals after the departures from
  every zone, in wide lag bins, and compares the counts with the null model (Makris, Ellis and Black
  2004). The zones of departure that stand out most are *followed* until the next look. Each fit
  looks at new zones of arrival and at a share of the others, those with the oldest look first.
* *Weighing, in every fit.* Candidates along the followed pairs of zones are weighed by the excess
  over the null model. Improbable candidates are dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from camtopod.arrays import (
    Floats,
    Indices,
    Ints,
    Longs,
    Rows,
    Singles,
    find_rows,
    ranges,
    ranges_in_parts,
)
from camtopod.learn.association.candidates import (
    CANDIDATES_AT_ONCE,
    Candidates,
    departures_in_reach,
    find_candidates,
    initial_hazards,
    number_pairs,
    possible,
    reach,
)
from camtopod.learn.association.em import START_FLOOR
from camtopod.learn.association.problem import Problem, exposures
from camtopod.learn.lags import NOISE_SD, excess_sd
from camtopod.learn.limits import (
    EVENT_PAIRS_MAX,
    WEIGHED_AT_ONCE,
    WEIGHED_MAX,
    ZONE_WEIGHED_AT_ONCE,
    arrivals_within,
)
from camtopod.learn.traffic import NullRates

PAIRS_FEW = 20_000
"""Number of pairs of zones up to which candidates are not screened, unless they are too many."""
LOOK_SHARE = 0.125
"""Share of the zones of arrival that each fit looks at again."""
ZONES_AT_ONCE = 64
"""Zones of arrival that are looked at together."""
WIDE_BINS = 4
"""Lag bins in a wide bin. A look compares every two wide bins in a row with the null model."""
SOURCES_PER_ZONE_MAX = 32
"""Largest number of zones of departure that are followed for one zone of arrival."""
LIKELY_MIN = 0.001
"""Probability up to which candidates are dropped or do not count."""
LIKELY_MAX = 3_000_000
LIKELY_PER_ARRIVAL = 16
"""Limits of the candidates kept for the joint fit, the likeliest: in all, or for each arrival if
that is more.
"""


class FollowedSources(Struct):
    """The zones of departure that are followed as sources of one zone of arrival."""

    sources: Longs
    """Keys (`place`) of these zones of departure."""
    looked: int
    """Number of events learned at the last look at the zone of arrival; -1 if there was none."""


class CandidateScreen:
    """Selects the candidates of each fit, and remembers which pairs of zones are followed.

    On a small site, `find` returns all candidates, and no pair is remembered.
    """

    def __init__(self, sources_by_place: Mapping[int, FollowedSources] | None = None) -> None:
        self.sources_by_place = dict(sources_by_place or {})
        """Zones of departure that are followed, by key (`place`) of the zone of arrival."""

    @staticmethod
    def is_needed(problem: Problem, candidates_max: int) -> bool:
        """Return True if there are too many candidates or pairs of zones for one fit.

        candidates_max: limit of the candidates; that of the pairs is `PAIRS_FEW`.
        """
        low, high = departures_in_reach(problem.departures.t, problem.arrivals.t, problem.bins)
        return int((high - low).sum()) > candidates_max or problem.zones**2 > PAIRS_FEW

    def find(
        self,
        problem: Problem,
        places: Longs,
        events_learned: int,
        candidates_max: int,
        everywhere: bool = False,
    ) -> Candidates:
        """Return the candidates of a window, screened if there are too many.

        places (zones,): key of each zone that stays the same from fit to fit (`place`).
        events_learned: number of events learned so far.
        candidates_max: number of candidates up to which all are returned.
        everywhere: True to look at every zone of arrival now, as there is no later fit.
        """
        if not self.is_needed(problem, candidates_max):
            self.sources_by_place = {}
            return find_candidates(problem)
        traffic = Traffic(problem)
        self._look(traffic, places, events_learned, everywhere)
        pairs = ZonePairs(problem, *self._pairs(places))
        blocks = pairs.blocks(WEIGHED_MAX)
        departure, arrival, pair, lag = _joined(_likely(traffic, pairs, block) for block in blocks)

        # Number the pairs of zones that are left.
        pair, source, target = number_pairs(pairs.source[pair], pairs.target[pair], problem.zones)
        return Candidates(departure, arrival, pair, lag, source, target)

    def _look(self, traffic: Traffic, places: Longs, events_learned: int, everywhere: bool) -> None:
        """Look at zones of arrival; forget zones that exist no more."""
        never = FollowedSources(np.zeros(0, np.int64), -1)
        self.sources_by_place = {p: self.sources_by_place.get(p, never) for p in places.tolist()}

        # All new zones, and a share of all zones at least.
        last_looks = np.array([record.looked for record in self.sources_by_place.values()])
        share = int(np.ceil((1.0 if everywhere else LOOK_SHARE) * len(places)))
        targets = np.argsort(last_looks, kind="stable")[: max(share, int((last_looks < 0).sum()))]

        # The sources that stand out most.
        for at_once in np.split(targets, range(ZONES_AT_ONCE, len(targets), ZONES_AT_ONCE)):
            above = traffic.excess(at_once)
            source_count = min(SOURCES_PER_ZONE_MAX, len(above))
            best = np.sort(np.argpartition(above, -source_count, axis=0)[-source_count:], axis=0)
            for target, sources, excess in zip(at_once, best.T, above.T, strict=True):
                source_places = places[sources[excess[sources] > 0]]
                self.sources_by_place[int(places[target])] = FollowedSources(
                    source_places, events_learned
                )

    def _pairs(self, places: Longs) -> tuple[Rows, Rows]:
        """Return the sources and the targets of the followed pairs of zones, by target."""
        source_lists = [record.sources for record in self.sources_by_place.values()]
        target = np.repeat(np.arange(len(places)), [len(sources) for sources in source_lists])
        source, exists = find_rows(places, np.concatenate(source_lists))
        return source[exists], target[exists]


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


def _joined(blocks: Iterable[Block]) -> tuple[Ints, Ints, Ints, Singles]:
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


def _likely(traffic: Traffic, pairs: ZonePairs, block: Block) -> Block:
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
    departure, arrival, pair, lag = _joined(zone_pairs.blocks(EVENT_PAIRS_MAX))
    return candidates._replace(
        departure=departure, arrival=arrival, pair=pairs[pair].astype(np.int32), lag=lag
    )


class Traffic:
    """Compares the arrivals after the departures from every zone with the null model.

    problem: departures and arrivals, not empty.
    """

    def __init__(self, problem: Problem) -> None:
        departures, arrivals, bins, zones, *_ = problem
        self.problem = problem
        self.exposure = exposures(problem)
        """(zones, bins) exposed departures."""
        self.null_model = NullRates(departures.t, departures.zone, arrivals.t, arrivals.zone, zones)

        # Wide bins to which any departure is exposed; one begins at a lag of 0. (zones, wide bins)
        wide = np.unique(np.append(0, np.arange(-bins.first % WIDE_BINS, bins.size, WIDE_BINS)))
        exposure = np.add.reduceat(self.exposure * bins.widths, wide, axis=1).astype(np.float32)
        is_exposed = exposure.any(axis=0)
        self._departure_seconds = exposure[:, is_exposed]
        self._edges = np.append(np.array(bins.limits)[wide[is_exposed]], bins.limits[-1])

        # Departures by part of the window, whose arrivals stay in the processor's cache, and zone.
        # The first arrival after each of them with a lag past each edge.
        group = np.arange(len(departures.t)) // CANDIDATES_AT_ONCE * zones + departures.zone
        by_group = np.argsort(group, kind="stable")
        self._first = np.searchsorted(
            group[by_group], np.arange((len(group) // CANDIDATES_AT_ONCE + 1) * zones + 1)
        )
        self._first_arrivals = [
            np.searchsorted(arrivals.t, np.maximum(departures.since, departures.t + edge))[by_group]
            for edge in self._edges
        ]

        # Camera of each zone; integers that hold the number of candidates of any pair of zones.
        self._camera = problem.cameras()
        count_max = np.bincount(departures.zone).max() * np.bincount(arrivals.zone).max()
        self._kind: type = np.uint16 if count_max < 1 << 16 else np.float32

    def excess(self, targets: Rows) -> Singles:
        """Return by how much the arrivals at k zones exceed the null model, (zones, k).

        targets (k,): the zones of arrival.

        The result is by zone of departure, in standard deviations of the null model at the lags
        with the largest excess (`excess_sd`), and at least 0.
        """
        result = np.zeros((self.problem.zones, len(targets)), np.float32)
        for above in self._excess_by_lag(targets):
            np.maximum(result, above, out=result)
        return result

    def peaks(self, targets: Rows) -> tuple[Singles, NDArray[np.int16]]:
        """Return the `excess`, and at which lags it is, as their number in order; (zones, k) each.

        targets (k,): the zones of arrival.
        """
        result = np.zeros((self.problem.zones, len(targets)), np.float32)
        peak = np.zeros(result.shape, np.int16)
        for number, above in enumerate(self._excess_by_lag(targets)):
            peak[above > result] = number
            np.maximum(result, above, out=result)
        return result, peak

    def _excess_by_lag(self, targets: Rows) -> Iterator[Singles]:
        """Yield the excess (zones, k) at the lags of every two wide bins in a row."""
        # For each arrival at any of these zones in turn, the number of earlier ones at each.
        departures, arrivals, _, zones, *_ = self.problem
        column = np.full(zones, -1)
        column[targets] = np.arange(len(targets))
        at = column[arrivals.zone]
        rows = np.flatnonzero(at >= 0)
        number = np.append(0, np.cumsum(at >= 0)).astype(np.int32)
        counts: NDArray[Any] = np.zeros((len(rows) + 1, len(targets)), self._kind)
        counts[np.arange(1, len(counts)), at[rows]] = 1
        np.cumsum(counts, axis=0, dtype=self._kind, out=counts)

        # Arrivals before each edge, added up over the departures from each zone.
        unit_weights: NDArray[Any] = np.ones(len(departures.t), self._kind)
        size = (len(self._first) - 1, len(counts))
        before = [
            (csr_matrix((unit_weights, number.take(first), self._first), shape=size) @ counts)
            .reshape(size[0] // zones, zones, len(targets))
            .sum(axis=0, dtype=self._kind)
            for first in self._first_arrivals
        ]

        # Before the exit, no object is in another view of the same camera.
        rates = self.null_model.rates_to(targets)
        is_same_camera = self._camera[:, None] == self._camera[targets]
        for k, edge in enumerate(self._edges[:-2]):
            expected = rates * self._departure_seconds[:, k : k + 2].sum(axis=1, keepdims=True)
            above = excess_sd(before[k + 2] - before[k], expected)
            if edge < 0:
                above[is_same_camera] = 0.0
            yield above


Place = TypeVar("Place", int, Longs)


def place(camera: Place, number: Place) -> Place:
    """Return the key of a zone, or of n zones, which stays the same from one fit to the next.

    camera: index of the camera.
    number: number of the zone among the camera's zones.
    """
    return (camera << 32) + number
