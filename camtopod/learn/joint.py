"""The joint fit: which arrival belongs to which departure, over all zones at once.

The thesis pairs the closest times of two zones (section 4.4), which is wrong as soon as two objects are on the way, and
tests each pair of zones alone, which cannot tell A -> C from A -> B -> C. Here every arrival has one source, an earlier
departure or the outside, and every departure causes at most one arrival. An expectation-maximisation fit shares each
arrival among its candidates:

* the *hazard* ``h[u, v](lag)`` is the rate at which an object that left zone u appears next at zone v, per second, per
  departure whose lag bin was exposed (its window is over; for a negative lag: its passage had begun);
* the *background* of zone v is a share of the local rate of arrivals there, so that a rhythm common to all zones (day and
  night) explains itself and makes no links.

The E step is the sum-product approximation of the marginals of a one-to-one assignment with misses and clutter
(Williams and Lau, IEEE Trans. AES 50(4), 2014), one sweep an iteration; the M step counts. Related: Marinakis and Dudek
(2005) sample what is summed here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.lags import LagBins, smoother
from camtopod.learn.rates import chance_rates
from camtopod.learn.slowness import NO_PERSISTENCE, adjusted_lag, agreement, combined, persistence

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

LEAVE_FLOOR = 0.02
"""An object is never surer than this to be seen again."""
PAIR_TABLE_MAX = 20_000_000
"""Largest dense table from (zone, zone) to candidate pair, entries."""


class Departures(NamedTuple):
    """Objects leaving, by time: ``t`` seconds, ``zone``, ``camera``, ``since`` when the passage began (-inf: unknown), and
    its log slowness (nan: unknown)."""

    t: Floats
    zone: Ints
    camera: Ints
    since: Floats
    slow: Floats


class Arrivals(NamedTuple):
    """Objects appearing, by time: ``t`` seconds, ``zone``, ``camera``, the local rate of arrivals there (1/s), and the log
    slowness of the passage that begins (nan: unknown)."""

    t: Floats
    zone: Ints
    camera: Ints
    rate: Floats
    slow: Floats


class Candidates(NamedTuple):
    """Every (departure, arrival) that may be one object, in order of arrival: indices (M,), and the pairs of zones (P,)."""

    departure: Ints
    arrival: Ints
    pair: Ints
    bin: Ints
    lag: Floats
    source: Ints
    target: Ints


class Fit(NamedTuple):
    """Result of the joint fit."""

    hazard: Floats
    """(P, bins) per second and exposed departure, smoothed."""
    counts: Floats
    """(P, bins) expected transitions."""
    responsibility: Floats
    """(M,) probability that the candidate is one object."""
    flat: Floats
    """(M,) hazard of the pair of zones if it did not depend on the lag, over the hazard."""
    outside: Floats
    """(zones,) share of the local rate of arrivals that no departure explains."""
    background: Floats
    """(arrivals,) rate of arrivals from outside at each arrival, 1/s."""
    exposure: Floats
    """(zones, bins) departures that were exposed in the bin."""


def find_candidates(
    departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int, candidates_max: int
) -> Candidates:
    """All departures within the lag range of each arrival; the oldest arrivals are left out beyond ``candidates_max``."""
    low = np.searchsorted(departures.t, arrivals.t - bins.lag_max, side="left")
    high = np.searchsorted(departures.t, arrivals.t - bins.lag_min, side="right")
    count = high - low
    beyond = np.cumsum(count[::-1])[::-1] > candidates_max
    count = np.where(beyond, 0, count)
    arrival = np.repeat(np.arange(len(count)), count)
    departure = np.arange(len(arrival)) + np.repeat(low - (np.cumsum(count) - count), count)
    lag = arrivals.t[arrival] - departures.t[departure]
    index = bins.index(lag)
    # A negative lag means two views at once: another camera, and the passage had begun.
    ahead = (departures.camera[departure] != arrivals.camera[arrival]) & (
        arrivals.t[arrival] > departures.since[departure]
    )
    keep = np.flatnonzero((index >= 0) & ((lag > 0) | ahead))
    arrival, departure, lag, index = arrival[keep], departure[keep], lag[keep], index[keep]
    key = departures.zone[departure].astype(np.int64) * zones + arrivals.zone[arrival]
    pair, present = _number_pairs(key, zones)
    return Candidates(
        departure.astype(np.int32), arrival.astype(np.int32), pair, index, lag,
        (present // max(zones, 1)).astype(np.int32), (present % max(zones, 1)).astype(np.int32),
    )  # fmt: skip


def _number_pairs(key: NDArray[np.int64], zones: int) -> tuple[Ints, NDArray[np.int64]]:
    """Consecutive numbers for the pairs of zones that occur, and their keys."""
    if zones * zones > PAIR_TABLE_MAX:
        present, number = np.unique(key, return_inverse=True)
        return number.astype(np.int32), present
    seen = np.zeros(zones * zones, bool)
    seen[key] = True
    present = np.flatnonzero(seen)
    table = np.zeros(zones * zones, np.int32)
    table[present] = np.arange(len(present), dtype=np.int32)
    return table[key], present


def exposures(departures: Departures, bins: LagBins, zones: int, until: float) -> Floats:
    """Departures of each zone whose lag bin could have been seen: (zones, bins).

    A bin after the exit is exposed once the window up to it is over (``until``, seconds); a bin before the exit only if
    the passage had begun by then.
    """
    exposed = np.zeros((zones, bins.size))
    ahead = bins.edges[1:] <= 0
    stay = departures.t - departures.since
    left = until - departures.t
    for zone in range(zones):
        here = departures.zone == zone
        sorted_left = np.sort(left[here])
        sorted_stay = np.sort(stay[here])
        n = len(sorted_left)
        exposed[zone] = np.where(
            ahead,
            n - np.searchsorted(sorted_stay, -bins.centres, side="left"),
            n - np.searchsorted(sorted_left, bins.edges[1:], side="left"),
        )
    return exposed


START_SMOOTHING_SD_BINS = (1.5, 3.0, 6.0)
START_NOISE_SD = 2.0
STRIDE = 1.8
"""Steps are longer than EM's own by this much (on the log scale; convergent below 2), as EM creeps here."""
SETTLING_ITERATIONS = 3
"""The last iterations take EM's own steps."""
START_FLOOR = 0.002
"""Share of a pair's own histogram that it starts with even where nothing exceeds chance."""

SMOOTHING_SD_BINS = ((50.0, 1.2), (12.0, 1.8), (0.0, 2.8))
"""(at least this many expected transitions, smooth by this many bins)."""


def smooth(counts: Floats) -> tuple[Floats, Floats]:
    """Counts (P, bins) spread over neighbouring bins, the wider the fewer there are; and the share (P,) that stays."""
    size = counts.shape[1]
    total = counts.sum(axis=1)
    result = np.zeros_like(counts)
    stays = np.zeros(len(total))
    above = np.full(len(total), False)
    for least, sd_bins in SMOOTHING_SD_BINS:
        rows = (total >= least) & ~above
        above |= rows
        if rows.any():
            spread = smoother(size, sd_bins)
            result[rows] = counts[rows] @ spread.T
            stays[rows] = spread[size // 2, size // 2]
    return result, stays


class JointFitter:
    """One run of the fit: holds the arrays that do not change from one iteration to the next."""

    def __init__(
        self, departures: Departures, arrivals: Arrivals, candidates: Candidates, bins: LagBins,
        zones: int, until: float,
    ) -> None:  # fmt: skip
        self.bins, self.zones = bins, zones
        self.candidates, self.departures, self.arrivals = candidates, departures, arrivals
        self.exposure = exposures(departures, bins, zones, until)
        self.cell = candidates.pair.astype(np.int64) * bins.size + candidates.bin
        self.agreement = np.ones(len(candidates.arrival))
        self.pairs = len(candidates.source)
        self.per_zone = np.bincount(arrivals.zone, minlength=zones).astype(float)
        self.outside = np.full(zones, 0.5)
        self.persistence = NO_PERSISTENCE
        self.message = np.ones(len(candidates.arrival))
        self.responsibility = np.zeros(len(candidates.arrival))
        self.own = np.zeros(self.pairs * bins.size)

    def use_slowness(self, responsibility: Floats) -> Floats:
        """Learn from the surest candidates how speed persists, and use it from here on; returns the hazards (P, bins)."""
        c = self.candidates
        left, came = self.departures.slow[c.departure], self.arrivals.slow[c.arrival]
        found = persistence(left, came, c.lag, c.pair, responsibility)
        self.persistence = found
        lag = adjusted_lag(c.lag, combined(left, came), found.scaling, self.bins)
        self.cell = c.pair.astype(np.int64) * self.bins.size + self.bins.index(lag)
        self.agreement = agreement(left, came, found)
        return self.hazards(self.count(responsibility))

    def start(self) -> Floats:
        """First hazards: what exceeds chance in each pair's own histogram (cross-correlation, Makris et al. 2004)."""
        seen = self.count(np.ones(len(self.candidates.arrival)))
        exposed = self.exposure[self.candidates.source] * self.bins.widths
        left, came = self.departures, self.arrivals
        by_chance = chance_rates(left.t, left.zone, came.t, came.zone, self.zones)
        chance = by_chance[self.candidates.source, self.candidates.target][:, None] * exposed
        excess = START_FLOOR * seen
        for sd_bins in START_SMOOTHING_SD_BINS:
            flat = smoother(self.bins.size, sd_bins)
            noise = np.sqrt(np.maximum(chance, 0.5) @ (flat**2).T)
            excess = np.maximum(excess, (seen - chance) @ flat.T - START_NOISE_SD * noise)
        return excess / np.maximum(exposed, self.bins.widths)

    def count(self, responsibility: Floats) -> Floats:
        """Expected transitions (P, bins)."""
        flat = np.bincount(self.cell, responsibility, minlength=self.pairs * self.bins.size)
        return flat.reshape(self.pairs, self.bins.size)

    def hazards(self, counts: Floats) -> Floats:
        """Counts over exposure, smoothed, per second: (P, bins)."""
        exposed = self.exposure[self.candidates.source]
        smoothed, stays = smooth(counts)
        self.own = np.repeat(stays, self.bins.size) / np.maximum(smoothed.ravel(), 1e-300)
        return smoothed / (np.maximum(exposed, 1.0) * self.bins.widths)

    def appears(self, hazard: Floats) -> Floats:
        """Probability (P,) that an object leaving at the source appears next at the target."""
        n = np.maximum(self.exposure.max(axis=1, keepdims=True), 1.0)
        share = (self.exposure / n)[self.candidates.source]
        share[:, self.bins.edges[1:] > 0] = 1.0
        total: Floats = (hazard * self.bins.widths * share).sum(axis=1)
        return total

    def expect(self, hazard: Floats) -> tuple[Floats, Floats]:
        """E step: responsibilities (M,) and background rates (arrivals,)."""
        c = self.candidates
        background = np.maximum(self.outside[self.arrivals.zone] * self.arrivals.rate, 1e-12)
        weight = hazard.ravel()[self.cell] * self.others() * self.agreement
        seen_again = np.bincount(c.source, self.appears(hazard), minlength=self.zones)
        leave = np.maximum(1.0 - seen_again, LEAVE_FLOOR)[self.departures.zone]
        taken = weight * self.message
        free = (leave + np.bincount(c.departure, taken, minlength=len(leave)))[c.departure] - taken
        offer = weight / free
        demand = (background + np.bincount(c.arrival, offer, minlength=len(background)))[c.arrival]
        self.message = 1.0 / np.maximum(demand - offer, 1e-12)
        self.responsibility = offer / demand
        return self.responsibility, background

    def others(self) -> Floats:
        """Share (M,) of each candidate's hazard that does not come from the candidate itself.

        Left in, a lone arrival would be its own evidence, and every piece of clutter would find a departure to belong to.
        """
        share: Floats = np.maximum(1.0 - self.responsibility * self.own[self.cell], 0.0)
        return share

    def run(self, iterations: int, hazard: Floats | None = None, outside: Floats | None = None) -> Fit:
        """EM from the given hazards (P, bins) and outside shares (zones,), or from an even start."""
        hazard = self.start() if hazard is None else hazard
        if outside is not None:
            self.outside = outside
        for iteration in range(iterations):
            responsibility, background = self.expect(hazard)
            counts = self.count(responsibility)
            explained = np.bincount(self.arrivals.zone, self.explained(responsibility), minlength=self.zones)
            self.outside = np.clip(1.0 - explained / np.maximum(self.per_zone, 1.0), 0.01, 1.0)
            fresh = self.hazards(counts)
            stride = STRIDE if iteration < iterations - SETTLING_ITERATIONS else 1.0
            hazard = fresh * (fresh / np.maximum(hazard, 1e-300)) ** (stride - 1.0)
        return Fit(hazard, counts, responsibility, self.flatness(hazard), self.outside, background, self.exposure)

    def flatness(self, hazard: Floats) -> Floats:
        """Hazard without its dependence on the lag over the hazard, of each candidate (M,)."""
        even = (hazard * self.bins.widths).sum(axis=1) / self.bins.widths.sum()
        flat: Floats = even[self.candidates.pair] / np.maximum(hazard.ravel()[self.cell], 1e-300)
        return flat

    def explained(self, responsibility: Floats) -> Floats:
        """Share of each arrival that some departure explains, (arrivals,)."""
        return np.bincount(self.candidates.arrival, responsibility, minlength=len(self.arrivals.t))
