"""The joint fit: which arrival belongs to which departure, over all zones at once.

The thesis pairs the closest times of two zones (section 4.4), which is wrong as soon as two objects
are on the way, and tests each pair of zones alone, which cannot tell A -> C from A -> B -> C. Here
every arrival has one source, an earlier departure or the outside, and every departure causes at
most one arrival. An expectation-maximisation fit shares each arrival among its candidates:

* the *hazard* ``h[u, v](lag)`` is the rate at which an object that left zone u appears next at zone v, per second,
  per departure whose lag bin was exposed (its window is over; for a negative lag: its passage had begun);
* the *background* of zone v is a share of the local rate of arrivals there, so that a rhythm common to all zones (day
  and night) explains itself and makes no links;
* *slowness* through a view foretells slowness on the way and in the next view, as far as the site shows that it does.

The E step is the sum-product approximation of the marginals of a one-to-one assignment with misses
and clutter (Williams and Lau, IEEE Trans. AES 50(4), 2014), one sweep an iteration, each candidate
judged by the hazard that the others make (leave one out). The M step counts. Related: Marinakis and
Dudek (2005) sample what is summed here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, Indices, Ints, Singles, rows_together
from camtopod.learn.association.candidates import Candidates, first_hazards, runs_of, together
from camtopod.learn.association.exposure import exposures
from camtopod.learn.traffic import (
    NO_PERSISTENCE,
    SURE_RESPONSIBILITY,
    Arrivals,
    Chance,
    Departures,
    Persistence,
    adjusted_lag,
    agreement,
    combined,
    persistence,
)
from camtopod.topology import LEAVE_FLOOR, LagBins, smooth

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
"""Steps are longer than EM's own by this much (on the log scale; convergent below 2), as EM creeps
here.
"""
STRIDE_RATIO_MAX = 4.0
SETTLING_ITERATIONS = 3
"""The last iterations of a round take EM's own steps."""
SPARSITY = 1.0
"""Most pairs of zones are not linked: their totals have a sparse prior (a Gamma with shape 0),
which takes one transition off each. Left out, thousands of pairs share the arrivals that come from
outside among them.
"""
FOLLOWED_TRANSITIONS_MIN = 0.05
"""A pair of zones with fewer expected transitions is not followed in later rounds."""
NOTHING = 1e-30
"""Fewer transitions than this are none, in single precision, too."""


class Fit(NamedTuple):
    """Result of the joint fit."""

    hazard: Singles
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


class Adjusted(NamedTuple):
    """Candidates (M,) as speed tells: the cell of each in a table (P, bins), by its lag at usual
    speed, and how well the slownesses before and after agree (None: nothing is known of that).
    """

    persistence: Persistence
    cell: Ints
    agreement: Singles | None

    def take(self, kept: Indices) -> Adjusted:
        """The candidates ``kept``, where pairs of zones keep their numbers."""
        return Adjusted(
            self.persistence,
            self.cell[kept],
            None if self.agreement is None else self.agreement[kept],
        )


class Tables(NamedTuple):
    """What a round of EM comes to."""

    hazard: Singles
    """(P, bins) per second and exposed departure, smoothed."""
    counts: Floats
    """(P, bins) expected transitions."""


def fit_jointly(
    departures: Departures,
    arrivals: Arrivals,
    candidates: Candidates,
    bins: LagBins,
    zones: int,
    until: float,
) -> Fit:
    """The joint fit of everything that left and came up to ``until`` (seconds), for what is linked:
    with a sparse prior and without what has next to nothing.

    Always from nothing: going on from the last one believes early mistakes ever more and sees too
    late what has opened.
    """
    fitter = JointFitter(departures, arrivals, candidates, bins, zones, until)
    tables = fitter.prune(
        fitter.run(
            fitter.run(fitter.use_slowness(fitter.run(fitter.start()).hazard)).hazard, SPARSITY
        )
    )
    for _ in range(SPARSE_ROUNDS_MAX - 1):
        before = fitter.persistence
        tables = fitter.prune(fitter.run(fitter.use_slowness(tables.hazard)))
        if (
            max(abs(now - then) for now, then in zip(fitter.persistence, before, strict=True))
            < SETTLED
        ):
            break
    return fitter.found(tables, fitter.flatness(tables.hazard))


class JointFitter:
    """The fit in progress: what does not change from one iteration to the next, and the messages
    between them.

    There may be millions of candidates: only what is kept of each is there for all of them, what is
    in between for some at a time (`together`). Where candidates are looked up, `take` does it in
    half the time that an index does.
    """

    def __init__(
        self,
        departures: Departures,
        arrivals: Arrivals,
        candidates: Candidates,
        bins: LagBins,
        zones: int,
        until: float,
        exposure: Floats | None = None,
        adjusted: Adjusted | None = None,
    ) -> None:
        """``exposure`` (zones, bins), ``adjusted`` candidates: where they are known already."""
        self.bins, self.zones = bins, zones
        self.departures, self.arrivals = departures, arrivals
        self._follow(candidates)
        self.exposure = exposures(departures, bins, zones, until) if exposure is None else exposure
        self._some_exposed = np.maximum(self.exposure, 1.0)
        n = self._some_exposed.max(axis=1, keepdims=True)
        self._exposed_share = np.where(bins.edges[1:] > 0, 1.0, self.exposure / n)
        self.sparsity = 0.0
        self._camera = np.zeros(zones, np.int64)
        self._camera[departures.zone] = departures.camera
        self._camera[arrivals.zone] = arrivals.camera
        self.persistence = NO_PERSISTENCE
        self.outside = np.full(zones, 0.5)
        self._per_zone = np.maximum(np.bincount(arrivals.zone, minlength=zones), 1.0)
        self._message = np.ones(len(candidates.lag), np.float32)
        self.responsibility: Singles = np.zeros(len(candidates.lag), np.float32)
        """(M,) probability that the candidate is one object."""
        self._drawn: Indices | None = (
            None  # the only candidates with a responsibility, ascending, where there are few
        )
        self._own = np.zeros((self.pairs, bins.size), np.float32)
        self._agreement: Singles | None = None
        if adjusted is None:
            self.use(NO_PERSISTENCE)
        else:
            self._use(adjusted)

    @property
    def pairs(self) -> int:
        """Number of pairs of zones followed, P."""
        return len(self.candidates.source)

    def start(self, noise_sd: float = START_NOISE_SD) -> Singles:
        """First hazards (P, bins): what exceeds chance and ``noise_sd`` standard deviations of it
        in each pair's own histogram.
        """
        c = self.candidates
        if len(c.lag) == 0:
            return np.zeros((self.pairs, self.bins.size), np.float32)
        seen = self._count(np.ones(part.stop - part.start) for part in self._parts)
        rates = self._chance().of(c.source, c.target)
        first = first_hazards(
            seen, rates, self.exposure, c.source, self.bins, noise_sd, START_FLOOR
        )
        return first.astype(np.float32)

    def _chance(self) -> Chance:
        """What there would be if departures and arrivals had nothing to do with each other."""
        left, came = self.departures, self.arrivals
        return Chance(left.t, left.zone, came.t, came.zone, self.zones)

    def run(self, hazard: Singles, sparsity: float | None = None) -> Tables:
        """One round of EM from the given hazards (P, bins); from here on with that ``sparsity``, if
        given.
        """
        self.sparsity = self.sparsity if sparsity is None else sparsity
        counts = np.zeros(0)
        for iteration in range(ITERATIONS):
            del counts  # they are as large as the new ones
            self._expect(hazard)
            counts = self._counted(self.responsibility)
            self._look_outside()
            fresh = self._hazards(counts)
            stride = STRIDE if iteration < ITERATIONS - SETTLING_ITERATIONS else 1.0
            if stride != 1.0:
                for rows in rows_together(self.pairs):
                    ratio = np.minimum(
                        fresh[rows] / np.maximum(hazard[rows], NOTHING), STRIDE_RATIO_MAX
                    )
                    fresh[rows] *= ratio ** (stride - 1.0)
            hazard = fresh
        return Tables(hazard, counts)

    def use_slowness(self, hazard: Singles) -> Singles:
        """Learn from the surest candidates how speed persists, and use it from here on; returns the
        hazards (P, bins) in the place of those before.

        What is sure is judged without looking at whether the slownesses agree, else agreement would
        breed itself.
        """
        c, before = self.candidates, self._to_count()
        self._agreement = None
        self._expect(hazard)
        del hazard  # they are as large as the new ones
        sure = np.flatnonzero(self.responsibility > SURE_RESPONSIBILITY)
        left, came = (
            self.departures.slow.take(c.departure[sure]),
            self.arrivals.slow.take(c.arrival[sure]),
        )
        each = self.responsibility[sure].astype(float)
        self.use(persistence(left, came, c.lag[sure].astype(float), c.pair[sure], each))
        return self._hazards(self._counted(before))

    def _to_count(self) -> Singles:
        """A copy of the responsibilities (M,), as far as they count for the hazards."""
        return self.responsibility.copy()

    def _follow(self, candidates: Candidates) -> None:
        """From here on these candidates, some at a time."""
        self.candidates = candidates
        self._parts = together(candidates.arrival)
        self._runs = [runs_of(candidates.arrival[part]) for part in self._parts]

    def use(self, found: Persistence) -> None:
        """Adjust lags and weigh candidates by what speed tells."""
        self._use(adjust(self.candidates, self.departures, self.arrivals, found, self.bins))

    def _use(self, adjusted: Adjusted) -> None:
        self.persistence, self._cell, self._agreement = adjusted

    def prune(self, tables: Tables) -> Tables:
        """Follow only the pairs of zones that have any transitions left."""
        alive = tables.counts.sum(axis=1) > FOLLOWED_TRANSITIONS_MIN
        kept = alive[self.candidates.pair]
        self._follow(self.candidates.take(kept))
        self._message, self.responsibility = self._message[kept], self.responsibility[kept]
        self.use(self.persistence)
        self._own = self._own[alive]
        return Tables(tables.hazard[alive], tables.counts[alive])

    def found(self, tables: Tables, flat: Floats) -> Fit:
        """The fit as it is known from outside."""
        return Fit(
            tables.hazard,
            tables.counts,
            self.responsibility.astype(float),
            flat,
            self.outside,
            self.candidates,
            self.persistence,
        )

    def expect_afresh(self, hazard: Singles, sweeps: int) -> Floats:
        """Responsibilities (M,) under hazards (P, bins) learned elsewhere: nothing left out,
        nothing known before.
        """
        self._message[:] = 1.0
        for _ in range(sweeps):
            self.responsibility[:] = 0.0
            self._expect(hazard)
        return self.responsibility.astype(float)

    def _expect(self, hazard: Singles) -> None:
        """E step: responsibilities in the place of those before."""
        result = self.responsibility
        background = np.maximum(self.outside[self.arrivals.zone] * self.arrivals.rate, 1e-12)

        # The demand on each departure, of all its candidates and of leaving.
        taken = np.zeros(len(self.departures.t))
        for part in self._parts:
            result[part] = weight = self._weights(hazard, part)
            np.add.at(taken, self._departure(part), (weight * self._message[part]).astype(float))
        taken += self._leave(hazard)

        # What each candidate has left for its arrival, beside the background and the other
        # candidates there.
        for part, run in zip(self._parts, self._runs, strict=True):
            weight = result[part]
            others = taken.take(self._departure(part))
            others -= weight * self._message[part]
            offer = np.divide(weight, others, out=others)
            demand = np.repeat(
                background[run.arrival] + np.add.reduceat(offer, run.first), run.candidates
            )
            np.divide(offer, demand, out=result[part])
            demand -= offer
            np.divide(1.0, np.maximum(demand, 1e-12, out=demand), out=self._message[part])

    def _departure(self, part: slice) -> Indices:
        """The departure of each candidate of a part; for a delayed copy, the original."""
        of, row = self.departures.of, self.candidates.departure[part].astype(np.intp)
        return row if of is None else of.take(row)

    def _believe(self, drawn: Indices) -> None:
        """The candidates ``drawn`` (ascending) are transitions, and no others."""
        self.responsibility[:] = 0.0
        self.responsibility[drawn] = 1.0
        self._drawn = drawn

    @property
    def _telling(self) -> Sequence[slice | Indices]:
        """The candidates with a responsibility, part by part."""
        return self._parts if self._drawn is None else [self._drawn]

    def _added(self, index: Indices, size: int) -> Floats:
        """Responsibilities (size,) added up by an ``index`` (M,)."""
        total = np.zeros(size)
        for part in self._telling:
            np.add.at(total, index[part].astype(np.intp), self.responsibility[part].astype(float))
        return total

    def _look_outside(self) -> None:
        """What no departure explains comes from outside."""
        explained = self._added(self.candidates.arrival, len(self.arrivals.t))
        per_zone = np.bincount(self.arrivals.zone, explained, minlength=self.zones)
        self.outside = np.clip(1.0 - per_zone / self._per_zone, OUTSIDE_FLOOR, 1.0)

    def _weights(self, hazard: Singles, part: slice) -> Singles:
        """Hazard of each candidate of a part that the others make."""
        cell = self._cell[part].astype(np.intp)
        weight = hazard.take(cell)
        # Leave one out: left in, a lone arrival would be its own evidence and all clutter would
        # find a departure.
        if self._drawn is None:
            weight *= self._others(cell, self.responsibility[part])
        else:
            drawn = self._drawn[within(self._drawn, part)]
            at = drawn - part.start
            weight[at] *= self._others(cell[at], self.responsibility[drawn])
        if self._agreement is not None:
            weight *= self._agreement[part]
        return weight

    def _others(self, cell: Indices, responsibility: Singles) -> Singles:
        """Share of the hazard in some cells of the tables that candidates other than these make."""
        own = self._own.take(cell)
        own *= responsibility
        others: Singles = np.maximum(np.subtract(1.0, own, out=own), 0.0, out=own)
        return others

    def _leave(self, hazard: Singles) -> Floats:
        """Probability (n,) that the object of each departure is not seen again."""
        share = np.zeros(self.pairs)
        for rows in rows_together(self.pairs):
            share[rows] = self._appears(self._after_exit(hazard, rows), rows).sum(axis=1)
        again: Floats = np.bincount(self.candidates.source, share, minlength=self.zones).astype(
            float
        )
        left: Floats = np.maximum(1.0 - self._of_all(again[self.departures.zone]), LEAVE_FLOOR)
        return left

    def _of_all(self, each: Floats) -> Floats:
        """Values of ``each`` departure (n,) added up over the departure and its delayed copies,
        (n,).
        """
        of = self.departures.of
        return each if of is None else np.bincount(of, each, minlength=len(of)).astype(float)[of]

    def _after_exit(self, hazard: Singles, rows: slice) -> Singles:
        """All hazard (rows, bins) that counts from the exit."""
        return hazard[rows]

    def _counted(self, responsibility: Singles) -> Floats:
        """Expected transitions (P, bins)."""
        return self._count(responsibility[part] for part in self._parts)

    def _count(self, shares: Iterable[Singles | Floats]) -> Floats:
        """Candidates (P, bins), of each so much, part by part."""
        flat = np.zeros(self.pairs * self.bins.size)
        for part, share in zip(self._telling, shares, strict=True):
            np.add.at(flat, self._cell[part].astype(np.intp), share.astype(float, copy=False))
        return flat.reshape(self.pairs, self.bins.size)

    def _hazards(self, counts: Floats) -> Singles:
        """M step: counts over exposure, smoothed, per second, (P, bins)."""
        hazard = self._smoothed(counts)
        for rows in rows_together(self.pairs):
            hazard[rows] /= self._exposed(rows) * self.bins.widths
        return hazard

    def _smoothed(self, counts: Floats) -> Singles:
        """Counts (P, bins) less the sparse prior, smoothed; by how much they grow with a
        candidate's own is noted.
        """
        total = counts.sum(axis=1)
        kept = np.maximum(total - self.sparsity, 1e-3 * total) if self.sparsity else total
        share = (kept / np.maximum(total, 1e-300))[:, None]
        smoothed = np.empty(counts.shape, np.float32)
        for rows in rows_together(self.pairs):
            some, stays = smooth(counts[rows], kept[rows])
            smoothed[rows] = some = some * share[rows]
            self._own[rows] = stays[:, None] / np.maximum(some, NOTHING)
        return smoothed

    def _exposed(self, rows: slice | Indices) -> Floats:
        """Departures (rows, bins) of the pairs of zones, at least 1."""
        return self._some_exposed.take(self.candidates.source[rows], axis=0)

    def _appears(self, hazard: Singles, rows: slice | Indices) -> Floats:
        """Probability (rows, bins) that an object leaving at the source appears next at the target
        in that lag bin.
        """
        appears: Floats = (
            hazard * self.bins.widths * self._exposed_share[self.candidates.source[rows]]
        )
        return appears

    def flatness(self, hazard: Singles) -> Floats:
        """Hazard without its dependence on the lag (`_even`) over the hazard, of each candidate
        (M,).
        """
        flat: Floats = self._even(hazard)[self.candidates.pair] / np.maximum(
            hazard.take(self._cell), NOTHING
        )
        return flat

    def hedged(self, hazard: Singles, even_share: float) -> Singles:
        """The hazards (P, bins) with a share of their transitions spread evenly over all lags."""
        return (1.0 - even_share) * hazard + (even_share * self._even(hazard)[:, None]).astype(
            np.float32
        )

    def _even(self, hazard: Singles) -> Floats:
        """Hazards (P,) that do not depend on the lag and make as many transitions as these (P,
        bins).
        """
        even, c = np.zeros(self.pairs), self.candidates
        one_view, ahead = self._camera[c.source] == self._camera[c.target], self.bins.edges[1:] <= 0
        for rows in rows_together(self.pairs):
            exposed = self.exposure[c.source[rows]] * self.bins.widths
            exposed[one_view[rows, None] & ahead] = (
                0.0  # within one view, no lag is before the exit
            )
            even[rows] = (hazard[rows] * exposed).sum(axis=1) / np.maximum(
                exposed.sum(axis=1), 1e-9
            )
        return even


def within(some: Indices, part: slice) -> slice:
    """Which of ``some`` (n,), ascending, belong to a part of all."""
    ends = np.array(
        (part.start, part.stop), some.dtype
    )  # of another type all of them would be copied
    return slice(*np.searchsorted(some, ends).tolist())


def adjust(
    candidates: Candidates,
    departures: Departures,
    arrivals: Arrivals,
    found: Persistence,
    bins: LagBins,
) -> Adjusted:
    """The candidates as the ``found`` persistence of speed tells."""
    c = candidates
    cell = np.empty(len(c.lag), np.int32)
    agree = np.empty(len(c.lag), np.float32) if found.correlation > 0 else None
    for part in together(c.arrival):
        lag = np.clip(c.lag[part].astype(float), bins.lag_min, bins.lag_max)
        if found != NO_PERSISTENCE:
            left, came = (
                departures.slow.take(c.departure[part]),
                arrivals.slow.take(c.arrival[part]),
            )
            lag = adjusted_lag(lag, combined(left, came), found.scaling, bins)
        cell[part] = c.pair[part] * bins.size + bins.index(lag)
        if agree is not None:
            agree[part] = agreement(left, came, found)
    return Adjusted(found, cell, agree)
