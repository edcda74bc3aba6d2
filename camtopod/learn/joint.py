"""The joint fit: which arrival belongs to which departure, over all zones at once.

The thesis pairs the closest times of two zones (section 4.4), which is wrong as soon as two objects are on the way, and
tests each pair of zones alone, which cannot tell A -> C from A -> B -> C. Here every arrival has one source, an earlier
departure or the outside, and every departure causes at most one arrival. An expectation-maximisation fit shares each
arrival among its candidates:

* the *hazard* ``h[u, v](lag)`` is the rate at which an object that left zone u appears next at zone v, per second,
  per departure whose lag bin was exposed (its window is over; for a negative lag: its passage had begun);
* the *background* of zone v is a share of the local rate of arrivals there, so that a rhythm common to all zones (day
  and night) explains itself and makes no links;
* *slowness* through a view foretells slowness on the way and in the next view, as far as the site shows that it does.

The E step is the sum-product approximation of the marginals of a one-to-one assignment with misses and clutter
(Williams and Lau, IEEE Trans. AES 50(4), 2014), one sweep an iteration, each candidate judged by the hazard that the
others make (leave one out). The M step counts. Related: Marinakis and Dudek (2005) sample what is summed here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.candidates import Arrivals, Candidates, Departures, excess
from camtopod.learn.grouping import rows_of
from camtopod.learn.lags import LagBins, smoother
from camtopod.learn.rates import Chance
from camtopod.learn.slowness import NO_PERSISTENCE, Persistence, adjusted_lag, agreement, combined, persistence

Floats = NDArray[np.float64]

LEAVE_FLOOR = 0.02
"""An object is never surer than this to be seen again."""
OUTSIDE_FLOOR = 0.01
START_NOISE_SD = 2.0
START_FLOOR = 0.002
"""Share of a pair's own histogram that it starts with even where nothing exceeds chance."""
ITERATIONS = 6
"""EM iterations a round; speed is looked at between rounds."""
SPARSE_ROUNDS_MAX = 4
SETTLED = 0.03
"""Rounds end when what speed tells changes by less than this."""
STRIDE = 1.8
"""Steps are longer than EM's own by this much (on the log scale; convergent below 2), as EM creeps here."""
STRIDE_RATIO_MAX = 4.0
SETTLING_ITERATIONS = 3
"""The last iterations of a round take EM's own steps."""
SPARSITY = 1.0
"""Most pairs of zones are not linked: their totals have a sparse prior (a Gamma with shape 0), which takes one
transition off each. Left out, thousands of pairs share the arrivals that come from outside among them.
"""
FOLLOWED_TRANSITIONS_MIN = 0.05
"""A pair of zones with fewer expected transitions is not followed in later rounds."""
SMOOTHING_SD_BINS = ((50.0, 1.2), (12.0, 1.8), (0.0, 2.8))
"""(at least this many expected transitions, smooth by this many bins)."""


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
    candidates: Candidates
    """The candidates still followed, to which ``responsibility`` and the pairs belong."""
    persistence: Persistence


def fit_jointly(
    departures: Departures, arrivals: Arrivals, candidates: Candidates, bins: LagBins, zones: int, until: float
) -> Fit:
    """The joint fit of everything that left and came up to ``until`` (seconds), for what is linked: with a sparse prior
    and without what has next to nothing.

    Always from nothing: one that goes on from the last as events come in believes early mistakes ever more, and sees
    too late what has opened.
    """
    fitter = JointFitter(departures, arrivals, candidates, bins, zones, until)
    first = fitter.run(fitter.start())
    hazard = fitter.run(fitter.use_slowness(first)).hazard
    fitter.sparsity = SPARSITY
    fit = fitter.prune(fitter.run(hazard))
    for _ in range(SPARSE_ROUNDS_MAX - 1):
        before = fitter.persistence
        fit = fitter.prune(fitter.run(fitter.use_slowness(fit)))
        if max(abs(now - then) for now, then in zip(fitter.persistence, before, strict=True)) < SETTLED:
            break
    return fit


class JointFitter:
    """The fit in progress: what does not change from one iteration to the next, and the messages between them.

    Where all candidates are looked up, `take` does it in half the time that an index does.
    """

    def __init__(
        self, departures: Departures, arrivals: Arrivals, candidates: Candidates, bins: LagBins,
        zones: int, until: float, exposure: Floats | None = None,
    ) -> None:  # fmt: skip
        """``exposure`` (zones, bins): where it is known already."""
        self.bins, self.zones = bins, zones
        self.candidates, self.departures, self.arrivals = candidates, departures, arrivals
        self.exposure = exposures(departures, bins, zones, until) if exposure is None else exposure
        self.sparsity = 0.0
        self._camera = np.zeros(zones, np.int64)
        self._camera[departures.zone] = departures.camera
        self._camera[arrivals.zone] = arrivals.camera
        self.persistence = NO_PERSISTENCE
        self.outside = np.full(zones, 0.5)
        self._per_zone = np.maximum(np.bincount(arrivals.zone, minlength=zones), 1.0)
        self._message = np.ones(len(candidates.lag))
        self._responsibility = np.zeros(len(candidates.lag))
        self._own = np.zeros(self.pairs * bins.size)
        self.use(NO_PERSISTENCE)

    @property
    def pairs(self) -> int:
        """Number of pairs of zones followed, P."""
        return len(self.candidates.source)

    def start(self, noise_sd: float = START_NOISE_SD) -> Floats:
        """First hazards (P, bins): what exceeds chance and ``noise_sd`` standard deviations of it in each pair's own
        histogram.
        """
        if len(self.candidates.lag) == 0:
            return np.zeros((self.pairs, self.bins.size))
        seen = self._count(np.ones(len(self.candidates.lag)))
        exposed = self.exposure[self.candidates.source] * self.bins.widths
        chance = self._chance().of(self.candidates.source, self.candidates.target)[:, None] * exposed
        above = np.maximum(excess(seen, chance, self.bins, noise_sd), START_FLOOR * seen)
        return above / np.maximum(exposed, self.bins.widths)

    def _chance(self) -> Chance:
        """What there would be if departures and arrivals had nothing to do with each other."""
        left, came = self.departures, self.arrivals
        return Chance(left.t, left.zone, came.t, came.zone, self.zones)

    def run(self, hazard: Floats) -> Fit:
        """One round of EM from the given hazards (P, bins)."""
        for iteration in range(ITERATIONS):
            responsibility = self._expect(hazard)
            counts = self._count(responsibility)
            self._look_outside()
            fresh = self._hazards(counts)
            stride = STRIDE if iteration < ITERATIONS - SETTLING_ITERATIONS else 1.0
            ratio = np.minimum(fresh / np.maximum(hazard, 1e-300), STRIDE_RATIO_MAX)
            hazard = fresh * ratio ** (stride - 1.0)
        flat = self.flatness(hazard)
        return Fit(hazard, counts, responsibility, flat, self.outside, self.candidates, self.persistence)

    def use_slowness(self, fit: Fit) -> Floats:
        """Learn from the surest candidates how speed persists, and use it from here on; returns the hazards (P, bins).

        What is sure is judged without looking at whether the slownesses agree, else agreement would breed itself.
        """
        self._agreement = np.ones(len(self.candidates.lag))
        plain = self._expect(fit.hazard)
        left, came = self._slownesses()
        self.use(persistence(left, came, self.candidates.lag, self.candidates.pair, plain))
        return self._hazards(self._count(fit.responsibility))

    def use(self, found: Persistence) -> None:
        """Adjust lags and weigh candidates by what speed tells."""
        c, (left, came) = self.candidates, self._slownesses()
        self.persistence = found
        lag = adjusted_lag(c.lag, combined(left, came), found.scaling, self.bins)
        self._cell = c.pair.astype(np.int64) * self.bins.size + self.bins.index(lag)
        self._agreement = agreement(left, came, found)

    def _slownesses(self) -> tuple[Floats, Floats]:
        """Slowness before and after of each candidate (M,)."""
        return self.departures.slow.take(self.candidates.departure), self.arrivals.slow.take(self.candidates.arrival)

    def prune(self, fit: Fit) -> Fit:
        """Follow only the pairs of zones that have any transitions left."""
        c = self.candidates
        alive = fit.counts.sum(axis=1) > FOLLOWED_TRANSITIONS_MIN
        kept = np.flatnonzero(alive[c.pair])
        number = np.cumsum(alive, dtype=np.int32) - 1
        self.candidates = Candidates(
            c.departure[kept], c.arrival[kept], number[c.pair[kept]], c.lag[kept], c.source[alive], c.target[alive]
        )
        self._message, self._responsibility = self._message[kept], self._responsibility[kept]
        self.use(self.persistence)
        self._own = self._own.reshape(-1, self.bins.size)[alive].ravel()
        return Fit(
            fit.hazard[alive], fit.counts[alive], fit.responsibility[kept], fit.flat[kept], fit.outside,
            self.candidates, self.persistence,
        )  # fmt: skip

    def expect_afresh(self, hazard: Floats, sweeps: int) -> Floats:
        """Responsibilities (M,) under hazards (P, bins) learned elsewhere: nothing left out, nothing known before."""
        self._message = np.ones(len(self.candidates.lag))
        for _ in range(sweeps):
            self._responsibility = np.zeros(len(self.candidates.lag))
            self._expect(hazard)
        return self._responsibility

    def _expect(self, hazard: Floats) -> Floats:
        """E step: responsibilities (M,)."""
        c = self.candidates
        background = np.maximum(self.outside[self.arrivals.zone] * self.arrivals.rate, 1e-12)
        weight, leave = self._weights(hazard), self._leave(hazard)
        taken = weight * self._message
        free = (leave + np.bincount(c.departure, taken, minlength=len(leave))).take(c.departure) - taken
        offer = weight / free
        demand = (background + np.bincount(c.arrival, offer, minlength=len(background))).take(c.arrival)
        self._message = 1.0 / np.maximum(demand - offer, 1e-12)
        self._responsibility = offer / demand
        return self._responsibility

    def _look_outside(self) -> None:
        """What no departure explains comes from outside."""
        explained = np.bincount(self.candidates.arrival, self._responsibility, minlength=len(self.arrivals.t))
        per_zone = np.bincount(self.arrivals.zone, explained, minlength=self.zones)
        self.outside = np.clip(1.0 - per_zone / self._per_zone, OUTSIDE_FLOOR, 1.0)

    def _weights(self, hazard: Floats) -> Floats:
        """Hazard (M,) of each candidate that the others make."""
        # Leave one out: left in, a lone arrival would be its own evidence and all clutter would find a departure.
        others = np.maximum(1.0 - self._responsibility * self._own.take(self._cell), 0.0)
        weight: Floats = hazard.take(self._cell) * others * self._agreement
        return weight

    def _leave(self, hazard: Floats) -> Floats:
        """Probability (n,) that the object of each departure is not seen again."""
        again = np.bincount(self.candidates.source, self._appears(hazard).sum(axis=1), minlength=self.zones)
        left: Floats = np.maximum(1.0 - again, LEAVE_FLOOR)[self.departures.zone]
        return left

    def _count(self, responsibility: Floats) -> Floats:
        """Expected transitions (P, bins)."""
        flat: Floats = np.bincount(self._cell, responsibility, minlength=self.pairs * self.bins.size).astype(float)
        return flat.reshape(self.pairs, self.bins.size)

    def _hazards(self, counts: Floats) -> Floats:
        """M step: counts over exposure, smoothed, per second, (P, bins)."""
        total = counts.sum(axis=1, keepdims=True)
        kept = np.maximum(total - self.sparsity, 1e-3 * total) / np.maximum(total, 1e-300)
        smoothed, stays = smooth(counts * kept)
        self._own = np.repeat(stays, self.bins.size) / np.maximum(smoothed.ravel(), 1e-300)
        exposed = np.maximum(self.exposure[self.candidates.source], 1.0)
        beforehand, departures = self._beforehand(counts, smoothed / exposed)
        return (smoothed + beforehand) / ((exposed + departures) * self.bins.widths)

    def _beforehand(self, counts: Floats, rates: Floats) -> tuple[Floats, float]:
        """Transitions (P, bins) that pairs are expected to have before any is seen, and of how many departures;
        ``rates`` (P, bins): transitions per exposed departure as seen.
        """
        return np.zeros(1), 0.0

    def _appears(self, hazard: Floats) -> Floats:
        """Probability (P, bins) that an object leaving at the source appears next at the target in that lag bin."""
        n = np.maximum(self.exposure.max(axis=1, keepdims=True), 1.0)
        share = np.where(self.bins.edges[1:] > 0, 1.0, self.exposure / n)[self.candidates.source]
        appears: Floats = hazard * self.bins.widths * share
        return appears

    def flatness(self, hazard: Floats) -> Floats:
        """Hazard without its dependence on the lag over the hazard, of each candidate (M,): as many transitions are
        expected of it.
        """
        exposed = self.exposure[self.candidates.source] * self.bins.widths
        even = (hazard * exposed).sum(axis=1) / np.maximum(exposed.sum(axis=1), 1e-9)
        flat: Floats = even[self.candidates.pair] / np.maximum(hazard.take(self._cell), 1e-300)
        return flat


def exposures(departures: Departures, bins: LagBins, zones: int, until: float) -> Floats:
    """Departures of each zone whose lag bin could have been seen: (zones, bins).

    A bin after the exit is exposed once the window up to it is over (``until``, seconds); one before the exit as far as
    the passage had begun by then.
    """
    exposed = np.zeros((zones, bins.size))
    ahead = int((bins.edges[1:] <= 0).sum())
    before = bins.edges[: ahead + 1]
    for zone, here in enumerate(rows_of(departures.zone, zones)):
        left = np.sort(until - departures.t[here])
        exposed[zone] = len(here) - np.searchsorted(left, bins.edges[1:], side="left")
        # The seconds in view by each edge, added up, grow by how many were in view, also where a bin is exposed in
        # part: where all passages are taken to last equally long, its few seconds would else look like a peak.
        stay = np.sort(np.minimum(departures.t[here] - departures.since[here], -bins.edges[0]))
        shorter = np.searchsorted(stay, -before, side="right")
        longer = np.append(np.cumsum(stay[::-1])[::-1], 0.0)[shorter]
        exposed[zone, :ahead] = np.diff(longer + (len(here) - shorter) * before) / bins.widths[:ahead]
    return exposed


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
