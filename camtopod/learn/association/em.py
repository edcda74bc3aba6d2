"""Expectation maximisation over candidates: which arrival belongs to which departure.

Every arrival has one cause: an earlier departure, or the outside. Every departure causes at most
one arrival. The rate at which a departure from zone u causes an arrival at zone v after a lag is
the *hazard* ``h[u, v](lag)``, per second and exposed departure; the *background* of v is a share of
the local rate of arrivals there, so a rhythm common to all zones explains itself and makes no
links.

The E step is the sum-product approximation of the marginals of a one-to-one assignment with misses
and clutter (Williams and Lau, IEEE Trans. AES 50(4), 2014), one sweep an iteration. Each candidate
is judged by the hazard that the others make (leave one out). The M step counts. Marinakis and Dudek
(2005) sample what is summed here.

A departure is *exposed* to a lag if an arrival after that lag would have been seen: the window
lasts long enough, or, for a negative lag, the passage had begun.

`Em` knows the hazards of pairs of zones. `run` iterates `expect` (E step) and `maximise` (M step),
which are the places to begin reading. A fit may add `Term`s (further ways in which a departure
causes an arrival), a prior, and what contexts say of single candidates and departures.

There may be millions of candidates. Only one array of a kind is kept for all of them; intermediate
results exist for some at a time (`slices_by_arrival`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from camtopod.arrays import Bools, Floats, Indices, Longs, Singles, row_slices
from camtopod.learn.association.candidates import (
    Candidates,
    initial_hazards,
    runs_of,
    slices_by_arrival,
)
from camtopod.learn.association.exposure import exposures
from camtopod.learn.association.speed_adjustment import Adjusted, adjust
from camtopod.learn.traffic import (
    NO_PERSISTENCE,
    SURE_RESPONSIBILITY,
    Arrivals,
    Departures,
    NullRates,
    Persistence,
    estimate_persistence,
)
from camtopod.topology import LEAVE_FLOOR, LagBins, smooth

OUTSIDE_FLOOR = 0.01
"""Smallest share of the local rate of arrivals that comes from outside."""
BACKGROUND_MIN = 1e-12
"""Smallest background and demand, 1/s."""
START_NOISE_SD = 2.0
"""Standard deviations of the null model that a first hazard must exceed."""
START_FLOOR = 0.002
"""Share of a pair's own histogram that it starts with even where nothing exceeds the null model."""
ITERATIONS = 6
"""EM iterations of a run."""
STRIDE = 1.8
"""Over-relaxation of EM updates on a log scale, convergent below 2; plain EM converges slowly."""
STRIDE_RATIO_MAX = 4.0
"""Largest ratio of new to old hazards that over-relaxation extrapolates."""
SETTLING_ITERATIONS = 3
"""The last iterations of a run are plain EM."""
NOTHING = 1e-30
"""Fewer transitions than this are none, in single precision, too."""


class Term(Protocol):
    """A way in which a departure causes an arrival, beside the hazard of its pair of zones."""

    rows: Indices
    """(m,) candidates that the term applies to, ascending."""

    share: Any
    """(m,) share of each candidate's rate that the term contributes."""

    def rates(self, here: slice, responsibility: Singles) -> Any:
        """Return the rates of a slice of `rows`, each made by the other candidates (leave one out).

        responsibility: of the candidates of that slice.
        """

    def after_exit(self, hazard: Singles, rows: slice) -> Singles:
        """Return the hazards (rows, bins) of some pairs of zones, those of the term included."""

    def learn(self, responsibility: Singles) -> None:
        """M step of the term, by the responsibilities (M,) of all candidates."""


class Expected(Protocol):
    """Transitions that a prior expects, and the ``departures`` they belong to."""

    departures: float

    def of(self, rows: slice, rates: Callable[[Longs], Floats]) -> Floats:
        """Return the expected transitions (rows, bins) of some pairs of zones."""


class PairPrior(Protocol):
    """A prior over the transitions of pairs of zones."""

    def expected(self, counts: Floats) -> Expected:
        """Return the prior expectation, given the ``counts`` (P, bins) of transitions."""


class Em:
    """A fit in progress: what stays the same from iteration to iteration, and the messages."""

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
        """Begin without any responsibility.

        until: Unix seconds up to which events have been received.
        exposure (zones, bins), adjusted: where they are known already.
        """
        self.departures, self.arrivals = departures, arrivals
        self.bins, self.zones = bins, zones

        # Additions to the model; none to begin with.
        self.terms: Sequence[Term] = ()
        self.prior: PairPrior | None = None
        self.sparsity = 0.0
        """Transitions that a sparse prior (a Gamma with shape 0) takes off each pair of zones."""
        self.multiplier: Singles | None = None
        """(M,) factor of each candidate's rate, by the context of its departure."""
        self.leaving: Floats | None = None
        """(n,) probability that the object of each departure leaves the site, where it is known."""
        self.near: Bools | None = None
        """(n,) departures that the null model of the first hazards counts; None: all."""

        # What is known of zones.
        self.exposure = exposures(departures, bins, zones, until) if exposure is None else exposure
        self.some_exposed = np.maximum(self.exposure, 1.0)
        """(zones, bins) exposed departures, at least 1."""
        most = self.some_exposed.max(axis=1, keepdims=True)
        self._exposed_share = np.where(bins.edges[1:] > 0, 1.0, self.exposure / most)
        self.camera = np.zeros(zones, np.int64)
        """(zones,) camera of each zone."""
        self.camera[departures.zone] = departures.camera
        self.camera[arrivals.zone] = arrivals.camera
        self.arrivals_of_zone = np.maximum(np.bincount(arrivals.zone, minlength=zones), 1.0)
        """(zones,) arrivals of each zone, at least 1."""
        self.outside = np.full(zones, 0.5)
        """(zones,) share of the local rate of arrivals that no departure explains."""

        # What is known of candidates.
        self._follow(candidates)
        self._agreement: Singles | None = None
        self._message = np.ones(len(candidates.lag), np.float32)
        self.responsibility: Singles = np.zeros(len(candidates.lag), np.float32)
        """(M,) probability that the candidate is of one object."""
        self._drawn: Indices | None = None  # the only candidates with a responsibility, ascending
        self.own = np.zeros((self.pairs, bins.size), np.float32)
        """(P, bins) share of a smoothed count that a transition in the bin contributes itself."""
        if adjusted is None:
            adjusted = adjust(candidates, departures, arrivals, NO_PERSISTENCE, bins)
        self.use(adjusted)

    @property
    def pairs(self) -> int:
        """Number of pairs of zones that are followed, P."""
        return len(self.candidates.source)

    # --- The loop ---------------------------------------------------------------------------------

    def start(self, noise_sd: float = START_NOISE_SD) -> Singles:
        """Return the first hazards (P, bins): the excess of each histogram over the null model.

        noise_sd: standard deviations of the null model that are subtracted, too.
        """
        c, left, came = self.candidates, self.departures, self.arrivals
        if len(c.lag) == 0:
            return np.zeros((self.pairs, self.bins.size), np.float32)
        seen = self._count(np.ones(part.stop - part.start) for part in self.parts)
        near = slice(None) if self.near is None else self.near
        null_model = NullRates(left.t[near], left.zone[near], came.t, came.zone, self.zones)
        rates = null_model.rates_of(c.source, c.target)
        first = initial_hazards(
            seen, rates, self.exposure, c.source, self.bins, noise_sd, START_FLOOR
        )
        return first.astype(np.float32)

    def run(self, hazard: Singles) -> Singles:
        """Return the hazards (P, bins) after `ITERATIONS` iterations from the given ones."""
        for iteration in range(ITERATIONS):
            self.expect(hazard)
            fresh = self.maximise()
            if iteration < ITERATIONS - SETTLING_ITERATIONS:
                for rows in row_slices(self.pairs):
                    ratio = fresh[rows] / np.maximum(hazard[rows], NOTHING)
                    fresh[rows] *= np.minimum(ratio, STRIDE_RATIO_MAX) ** (STRIDE - 1.0)
            hazard = fresh
        return hazard

    def expect(self, hazard: Singles) -> None:
        """E step: replace the responsibilities by those under the hazards (P, bins)."""
        result = self.responsibility
        background = self.outside[self.arrivals.zone] * self.arrivals.rate
        background = np.maximum(background, BACKGROUND_MIN)

        # Demand on each departure: of all its candidates, and of leaving the site.
        taken = np.zeros(len(self.departures.t))
        for part in self.parts:
            result[part] = weight = self._rates(hazard, part)
            np.add.at(taken, self._departure(part), (weight * self._message[part]).astype(float))
        taken += self._leaving(hazard)

        # Offer of each candidate to its arrival, beside the background and the other candidates
        # there; and the message back: what the arrival demands of others.
        for part, run in zip(self.parts, self._runs, strict=True):
            weight = result[part]
            others = taken.take(self._departure(part))
            others -= weight * self._message[part]
            offer = np.divide(weight, others, out=others)
            demand = background[run.arrival] + np.add.reduceat(offer, run.first)
            demand = np.repeat(demand, run.candidates)
            np.divide(offer, demand, out=result[part])
            demand -= offer
            np.maximum(demand, BACKGROUND_MIN, out=demand)
            np.divide(1.0, demand, out=self._message[part])

    def maximise(self) -> Singles:
        """M step: return the hazards (P, bins) by the responsibilities, and update the terms."""
        for term in self.terms:
            term.learn(self.responsibility)
        self._estimate_outside()
        return self.hazards(self.transitions())

    def learn_speed(self, hazard: Singles) -> Singles:
        """Estimate from the surest candidates how speed persists, and adjust the candidates by it.

        Returns the hazards (P, bins) in place of the given ones. Which candidates are sure is
        decided without the agreement of slownesses, or agreement would reinforce itself.
        """
        before = np.concatenate([np.zeros(0, np.float32), *map(self.at_exit, self.parts)])

        # The surest candidates, whatever their slownesses.
        self._agreement = None
        self.expect(hazard)
        sure = np.flatnonzero(self.responsibility > SURE_RESPONSIBILITY)
        c = self.candidates
        found = estimate_persistence(
            self.departures.slow.take(c.departure[sure]),
            self.arrivals.slow.take(c.arrival[sure]),
            c.lag[sure].astype(float),
            c.pair[sure],
            self.responsibility[sure].astype(float),
        )

        self.use(adjust(c, self.departures, self.arrivals, found, self.bins))
        return self.hazards(self._count(before[part] for part in self.parts))

    def keep_pairs(self, alive: Bools) -> None:
        """Follow only the pairs of zones (P,) that are ``alive``."""
        kept = alive[self.candidates.pair]
        self._follow(self.candidates.take(kept))
        self._message, self.responsibility = self._message[kept], self.responsibility[kept]
        self.own = self.own[alive]
        found = self.persistence
        self.use(adjust(self.candidates, self.departures, self.arrivals, found, self.bins))

    def responsibilities_under(self, hazard: Singles, sweeps: int) -> Floats:
        """Return the responsibilities (M,) under hazards (P, bins) that were estimated elsewhere.

        No candidate is left out of them, as none has contributed to them.
        """
        self._message[:] = 1.0
        for _ in range(sweeps):
            self.responsibility[:] = 0.0
            self.expect(hazard)
        return self.responsibility.astype(float)

    # --- Candidates -------------------------------------------------------------------------------

    def use(self, adjusted: Adjusted) -> None:
        """Use the lags and the agreement of speed of these adjusted candidates."""
        self.persistence: Persistence = adjusted.persistence
        self.cell = adjusted.cell
        self._agreement = adjusted.agreement

    def draw(self, drawn: Indices) -> None:
        """Take the candidates ``drawn`` (ascending) for transitions, and no others."""
        self.responsibility[:] = 0.0
        self.responsibility[drawn] = 1.0
        self._drawn = drawn

    def end_draw(self) -> None:
        """Any candidate may have a responsibility again."""
        self._drawn = None

    def summed(self, index: Indices, size: int) -> Floats:
        """Return the sums (size,) of the responsibilities that have the same index.

        index (M,): number below ``size`` of each candidate, such as its pair of zones.
        """
        total = np.zeros(size)
        for part in self._telling:
            np.add.at(total, index[part].astype(np.intp), self.responsibility[part].astype(float))
        return total

    def transitions(self) -> Floats:
        """Return the expected transitions (P, bins) whose lag counts from the exit."""
        return self._count(map(self.at_exit, self._telling))

    def at_exit(self, part: slice | Indices) -> Singles:
        """Return the responsibilities of some candidates without the shares of the terms."""
        shares = self.responsibility[part]
        if not self.terms:
            return shares
        of_terms = np.zeros(len(shares), np.float32)
        for term in reversed(self.terms):
            if isinstance(part, slice):
                here = within(term.rows, part)
                of_terms[term.rows[here] - part.start] += term.share[here]
            else:
                drawn = np.flatnonzero(self.responsibility[term.rows])
                of_terms[np.searchsorted(part, term.rows[drawn])] += term.share[drawn]
        own: Singles = shares * np.maximum(1.0 - of_terms, 0.0)
        return own

    def _follow(self, candidates: Candidates) -> None:
        """Use these candidates from here on, some at a time."""
        self.candidates = candidates
        self.parts = slices_by_arrival(candidates.arrival)
        self._runs = [runs_of(candidates.arrival[part]) for part in self.parts]

    def _departure(self, part: slice) -> Indices:
        """Return the departure of each candidate of a part; for a delayed copy, the original."""
        of, row = self.departures.of, self.candidates.departure[part].astype(np.intp)
        return row if of is None else of.take(row)

    @property
    def _telling(self) -> Sequence[slice | Indices]:
        """The candidates with a responsibility, part by part."""
        return self.parts if self._drawn is None else [self._drawn]

    # --- Rates ------------------------------------------------------------------------------------

    def _rates(self, hazard: Singles, part: slice) -> Singles:
        """Return the rate of each candidate of a part, made by the other candidates."""
        # Leave one out: otherwise a lone arrival would be its own evidence, and all clutter would
        # find a departure.
        cell = self.cell[part].astype(np.intp)
        weight = hazard.take(cell)
        if self._drawn is None:
            weight *= self._others(cell, self.responsibility[part])
        else:
            drawn = self._drawn[within(self._drawn, part)]
            at = drawn - part.start
            weight[at] *= self._others(cell[at], self.responsibility[drawn])
        if self._agreement is not None:
            weight *= self._agreement[part]

        # The other terms, and their shares.
        added = []
        for term in self.terms:
            here = within(term.rows, part)
            rows = term.rows[here].astype(np.intp)
            rates = term.rates(here, self.responsibility.take(rows))
            if self._agreement is not None:
                rates *= self._agreement.take(rows)
            weight[rows - part.start] += rates
            added.append((term, here, rows, rates))
        for term, here, rows, rates in added:
            term.share[here] = rates / np.maximum(weight.take(rows - part.start), NOTHING)

        if self.multiplier is not None:
            weight *= self.multiplier[part]
        return weight

    def _others(self, cell: Indices, responsibility: Singles) -> Singles:
        """Return the share of the hazard in some cells that candidates other than these make."""
        own = self.own.take(cell)
        own *= responsibility
        others: Singles = np.maximum(np.subtract(1.0, own, out=own), 0.0, out=own)
        return others

    def _leaving(self, hazard: Singles) -> Floats:
        """Return the probability (n,) that the object of each departure leaves the site."""
        if self.leaving is not None:
            return self.leaving
        share = np.zeros(self.pairs)
        for rows in row_slices(self.pairs):
            share[rows] = self.appears(self.after_exit(hazard, rows), rows).sum(axis=1)
        again = np.bincount(self.candidates.source, share, minlength=self.zones).astype(float)
        left: Floats = np.maximum(1.0 - self.over_copies(again[self.departures.zone]), LEAVE_FLOOR)
        return left

    def over_copies(self, each: Floats) -> Floats:
        """Return values of ``each`` departure (n,) summed over it and its delayed copies, (n,)."""
        of = self.departures.of
        return each if of is None else np.bincount(of, each, minlength=len(of)).astype(float)[of]

    def after_exit(self, hazard: Singles, rows: slice) -> Singles:
        """Return the hazards (rows, bins) of some pairs whose lags count from the exit.

        Those of all terms are included.
        """
        result = hazard[rows]
        for term in self.terms:
            result = term.after_exit(result, rows)
        return result

    def appears(self, hazard: Singles, rows: slice | Indices) -> Floats:
        """Return the probability (rows, bins) that an object appears next at the target."""
        appears: Floats = (
            hazard * self.bins.widths * self._exposed_share[self.candidates.source[rows]]
        )
        return appears

    # --- Counts -----------------------------------------------------------------------------------

    def _estimate_outside(self) -> None:
        """Count as coming from outside what no departure explains."""
        explained = self.summed(self.candidates.arrival, len(self.arrivals.t))
        of_zone = np.bincount(self.arrivals.zone, explained, minlength=self.zones)
        self.outside = np.clip(1.0 - of_zone / self.arrivals_of_zone, OUTSIDE_FLOOR, 1.0)

    def _count(self, shares: Iterable[Singles | Floats]) -> Floats:
        """Return the candidates counted by pair of zones and lag (P, bins), each by its share."""
        flat = np.zeros(self.pairs * self.bins.size)
        for part, share in zip(self._telling, shares, strict=True):
            np.add.at(flat, self.cell[part].astype(np.intp), share.astype(float, copy=False))
        return flat.reshape(self.pairs, self.bins.size)

    def hazards(self, counts: Floats) -> Singles:
        """Return counts over exposure, smoothed, per second (P, bins), with what the prior adds."""
        expected = None if self.prior is None else self.prior.expected(counts)
        smoothed = self._smoothed(counts)
        del counts  # larger than the hazards

        hazard = np.empty_like(smoothed)
        for rows in row_slices(self.pairs):
            exposed = self.exposed(rows)
            if expected is None:
                np.divide(smoothed[rows], exposed * self.bins.widths, out=hazard[rows])
            else:
                more = expected.of(rows, lambda back: smoothed[back] / self.exposed(back))
                exposed = (exposed + expected.departures) * self.bins.widths
                np.divide(smoothed[rows] + more, exposed, out=hazard[rows])
        return hazard

    def _smoothed(self, counts: Floats) -> Singles:
        """Return the counts (P, bins) less the sparse prior, smoothed; set `own` accordingly."""
        total = counts.sum(axis=1)
        kept = np.maximum(total - self.sparsity, 1e-3 * total) if self.sparsity else total
        share = (kept / np.maximum(total, 1e-300))[:, None]
        smoothed = np.empty(counts.shape, np.float32)
        for rows in row_slices(self.pairs):
            some, stays = smooth(counts[rows], kept[rows])
            smoothed[rows] = some = some * share[rows]
            self.own[rows] = stays[:, None] / np.maximum(some, NOTHING)
        return smoothed

    def exposed(self, rows: slice | Indices) -> Floats:
        """Return the exposed departures (rows, bins) of some pairs of zones, at least 1."""
        return self.some_exposed.take(self.candidates.source[rows], axis=0)

    # --- Lags against no particular lag -----------------------------------------------------------

    def flatness(self, hazard: Singles) -> Floats:
        """Return the hazard without dependence on the lag over its own, for each candidate (M,)."""
        own = np.maximum(hazard.take(self.cell), NOTHING)
        flat: Floats = self._even(hazard)[self.candidates.pair] / own
        return flat

    def hedged(self, hazard: Singles, even_share: float) -> Singles:
        """Return the hazards (P, bins) with a share of their transitions spread over all lags."""
        even = (even_share * self._even(hazard)[:, None]).astype(np.float32)
        return (1.0 - even_share) * hazard + even

    def _even(self, hazard: Singles) -> Floats:
        """Return hazards (P,) that are the same at every lag and make as many transitions."""
        even, c = np.zeros(self.pairs), self.candidates
        one_view = self.camera[c.source] == self.camera[c.target]
        before = self.bins.edges[1:] <= 0
        for rows in row_slices(self.pairs):
            exposed = self.exposure[c.source[rows]] * self.bins.widths
            exposed[one_view[rows, None] & before] = 0.0  # in one view no lag is before the exit
            total = np.maximum(exposed.sum(axis=1), 1e-9)
            even[rows] = (hazard[rows] * exposed).sum(axis=1) / total
        return even


def within(some: Indices, part: slice) -> slice:
    """Return which of ``some`` (n,), ascending, belong to a part of all."""
    ends = np.array((part.start, part.stop), some.dtype)  # another type would copy all of them
    return slice(*np.searchsorted(some, ends).tolist())
