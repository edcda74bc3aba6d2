"""Expectation maximisation over candidates: which arrival belongs to which departure (METHOD 5).

The model: every arrival has one cause, a departure or the outside. Every departure causes at most
one arrival. The rate at which a departure from zone u causes an arrival at zone v after a lag is
the *hazard* ``h[u, v](lag)``, per second and exposed departure (`problem.exposures`). The
*background* of v, the rate of arrivals from outside, is a share of the local rate of arrivals at v;
as that is local in time, a rhythm common to all zones makes no links.

`Em` is a fit in progress over M candidates of P pairs of zones. `Em.run` iterates the E step
(`Em.expect`), which computes the responsibility of each candidate from the hazards, and the M step
(`Em.maximise`), which computes the hazards from the responsibilities. The E step is one sweep of
the messages of `sum_product`. Each candidate is judged by the hazard that the other candidates make
(leave one out). What a fit assumes in addition is its `em_model.EmModel`; the outer loops are in
`joint_fit` and `next_camera.fit`.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from camtopod.arrays import Bools, Floats, Indices, Singles, row_slices
from camtopod.learn.association.candidates import (
    CANDIDATES_AT_ONCE,
    Candidates,
    initial_hazards,
)
from camtopod.learn.association.convergence import ConvergenceMonitor
from camtopod.learn.association.em_model import NO_ADDITIONS, EmModel
from camtopod.learn.association.problem import Problem, exposures
from camtopod.learn.association.speed_adjustment import Adjusted, adjust
from camtopod.learn.association.sum_product import DEMAND_MIN, answers, claims, offers
from camtopod.learn.traffic import (
    NO_PERSISTENCE,
    SURE_RESPONSIBILITY,
    NullRates,
    estimate_label_persistence,
    estimate_persistence,
    first_weights,
)
from camtopod.topology import LEAVE_FLOOR, favours, smooth

OUTSIDE_FLOOR = 0.01
"""Lower bound on the share of the local rate of arrivals that comes from outside."""
START_NOISE_SD = 2.0
"""Standard deviations of the null model that are subtracted from lag histograms for first hazards.
"""
START_FLOOR = 0.002
"""Share of a pair's lag histogram that makes its first hazard where nothing exceeds the null model.
"""
STRIDE = 1.8
"""Over-relaxation factor of EM updates on a log scale; plain EM (factor 1) converges slowly.
Over-relaxation converges for factors below 2.
"""
STRIDE_RATIO_MAX = 4.0
"""Largest ratio of new to old hazards that over-relaxation extrapolates."""
DEAD_SHARE = 0.003
"""Share of all expected transitions that the unlikeliest candidates may have for them to be left
out of the rest of a fit. These are most candidates.
"""
SWEEPS = 3
"""Number of E steps under given hazards, and of sweeps in those of paths, over which the messages
settle.
"""
FEW = 200_000
"""Number of candidates up to which none are left out."""
NOTHING = 1e-30
"""Lower bound on a divisor; small, but not 0 in single precision."""


class Em:
    """A fit in progress: M candidates of P pairs of zones, and their responsibilities.

    Hazards (P, bins) are arguments and results of the methods; all else is kept here.
    """

    def __init__(
        self,
        problem: Problem,
        candidates: Candidates,
        model: EmModel = NO_ADDITIONS,
        exposure: Floats | None = None,
        adjustment: Adjusted | None = None,
    ) -> None:
        """Begin a fit with responsibilities of 0.

        exposure (R, bins): exposed departures of each range of lags; None to compute them.
        adjustment: the candidates adjusted for speed; None to begin without adjustment.
        """
        _, arrivals, bins, zones, *_ = problem
        self.problem = problem
        self.model = model
        """The additions; they are replaced as the fit goes on."""

        # Figures of zones and of ranges of lags.
        self.exposure = exposures(problem) if exposure is None else exposure
        """(R, bins) exposed departures."""
        self.exposure_at_least_one = np.maximum(self.exposure, 1.0)
        """(R, bins) exposed departures, at least 1: a divisor."""
        # The share of departures whose object can appear elsewhere at a lag. It is 1 after the
        # exit; before the exit, it is about the share of passages that had begun by then.
        exposure_max = self.exposure_at_least_one.max(axis=1, keepdims=True)
        self._able_share = np.where(bins.edges[1:] > 0, 1.0, self.exposure / exposure_max)
        self.camera = problem.cameras()
        """(zones,) camera of each zone."""
        self.arrivals_of_zone = np.maximum(np.bincount(arrivals.zone, minlength=zones), 1.0)
        """(zones,) arrivals of each zone, at least 1."""
        self.outside = np.full(zones, 0.5)
        """(zones,) share of the local rate of arrivals that no departure explains."""
        self.monitor = ConvergenceMonitor()
        """Tells whether the newest run of iterations has converged."""

        # Figures of candidates. Messages are those of the sum-product algorithm, from arrivals to
        # candidates.
        self._use(candidates)
        self._message = np.ones(len(candidates.lag), np.float32)
        self.responsibility: Singles = np.zeros(len(candidates.lag), np.float32)
        """(M,) probability that the candidate is of one object."""
        self.own_share = np.zeros((self.pairs, bins.size), np.float32)
        """(P, bins) share that one transition in a bin contributes to the smoothed count there.

        With 0.15, a candidate with a responsibility of 0.8 is judged by 1 - 0.8 * 0.15 = 0.88 of
        the hazard of its bin.
        """
        self.adjustment = adjustment or adjust(problem, candidates, NO_PERSISTENCE)
        """The candidates, adjusted for speed."""

    def _use(self, candidates: Candidates) -> None:
        """Index the candidates: by arrival (those that have any), and by departure."""
        self.candidates = candidates
        arrival = candidates.arrival
        self._first = np.flatnonzero(np.diff(arrival, prepend=-1))
        self._arrival_rows = arrival[self._first]
        self._times = np.diff(self._first, append=len(arrival))
        begins = np.searchsorted(self._first, np.arange(0, len(arrival), CANDIDATES_AT_ONCE))
        cuts = [*np.unique(begins).tolist(), len(self._first)]
        ends = np.append(self._first, len(arrival))[cuts].tolist()
        self._parts = [
            (slice(*rows), slice(*arrival_rows))
            for rows, arrival_rows in zip(pairwise(ends), pairwise(cuts), strict=True)
        ]
        """Rows of the candidates, and of the arrivals with any, that are processed together."""
        self._departure = candidates.departure.astype(np.intp)
        self.range_of = self.problem.range_of(candidates.source, candidates.target)
        """(P,) range of the lags of each pair of zones."""
        odds = self.problem.odds_of(candidates.source, candidates.target)
        self._favour = None if odds is None else favours(odds).take(candidates.pair)
        """(M,) factor on each candidate's rate by what was declared of its cameras; None for 1."""

    @property
    def pairs(self) -> int:
        """Number of pairs of zones that are followed, P."""
        return len(self.candidates.source)

    # --- Changes from outside ---------------------------------------------------------------------

    def live(self) -> Bools:
        """Return a mask (M,) of the likeliest candidates, with all but `DEAD_SHARE` of the mass.

        Without the others, the share of their arrivals that they explain counts as background. Of
        few candidates, all are returned: with little data, many unlikely ones are right.
        """
        if len(self.responsibility) <= FEW:
            return np.ones(len(self.responsibility), np.bool_)
        ascending = np.sort(self.responsibility)
        mass = np.cumsum(ascending, dtype=float)
        dead = int(np.searchsorted(mass, DEAD_SHARE * mass[-1]))
        live: Bools = self.responsibility >= ascending[dead]
        return live

    # --- The loop ---------------------------------------------------------------------------------

    def start(self, noise_sd: float = START_NOISE_SD) -> Singles:
        """Return the first hazards (P, bins): excess of each lag histogram over the null model.

        noise_sd: standard deviations of the null model that are subtracted in addition.
        """
        c = self.candidates
        departures, arrivals, bins, zones, *_ = self.problem
        self.responsibility[:] = 0.0
        self._message[:] = 1.0
        if len(c.lag) == 0:
            return np.zeros((self.pairs, bins.size), np.float32)
        weight, factor = self._first_weights()
        histograms = self._count(weight)
        near = self.model.near
        null_model = NullRates(
            departures.t[near], departures.zone[near], arrivals.t, arrivals.zone, zones
        )
        rates = null_model.rates_of(c.source, c.target)
        rates *= factor
        return initial_hazards(
            histograms, rates, self.exposure, self.range_of, bins, noise_sd, START_FLOOR
        ).astype(np.float32)

    def _first_weights(self) -> tuple[Singles, float]:
        """Return the weight (M,) of each candidate in `start`, and that of unrelated ones."""
        arrivals = self.problem.arrivals
        weight = arrivals.weights(self.candidates.arrival)
        likeness, share = self.adjustment.likeness, arrivals.label_share
        if likeness is None or share is None:
            return weight, 1.0
        by_label, factor = first_weights(likeness, share, self.adjustment.persistence.label)
        return weight * by_label, factor

    def run(self, hazard: Singles) -> Singles:
        """Return the hazards (P, bins) after a run of EM.

        hazard (P, bins): the hazards to begin with.
        """
        self.monitor = ConvergenceMonitor()
        for iteration in self.monitor:
            self.expect(hazard)
            fresh = self.maximise()
            # Over-relaxation: the step of the log hazards is `STRIDE` times that of plain EM; in
            # other words, the ratio of new to old hazards is raised to the power of `STRIDE`. The
            # second half is plain EM, so that the result is one of the M step.
            if iteration < self.monitor.iterations_max // 2:
                for rows in row_slices(self.pairs):
                    ratio = fresh[rows] / np.maximum(hazard[rows], NOTHING)
                    fresh[rows] *= np.minimum(ratio, STRIDE_RATIO_MAX) ** (STRIDE - 1.0)
            hazard = fresh
        return hazard

    def expect(self, hazard: Singles) -> None:
        """Do the E step: replace the responsibilities by those under the hazards (P, bins).

        The old responsibilities are an input, too: they tell how much each candidate has
        contributed to the hazards, which is left out (`_rates`). So are the messages of the E step
        before, which are replaced as well (``_message``), as is the share of the entry kernels.
        """
        rate = self._rates(hazard)
        claim_sums = claims(rate, self._message, self._departure, self._leaving(hazard))
        zone = self.problem.arrivals.zone[self._arrival_rows]
        outside = self.outside[zone] * self.problem.arrivals.rate[self._arrival_rows]
        background = np.maximum(outside, DEMAND_MIN)
        for rows, arrival_rows in self._parts:
            offer = offers(rate[rows], self._message[rows], self._departure[rows], claim_sums)
            demand = np.repeat(
                background[arrival_rows]
                + np.add.reduceat(offer, self._first[arrival_rows] - rows.start),
                self._times[arrival_rows],
            )
            self.responsibility[rows], self._message[rows] = answers(offer, demand)

    def maximise(self) -> Singles:
        """Do the M step for the entry kernels and the hazards (P, bins); return the hazards."""
        if self.model.kernels is not None:
            self.model.kernels.learn(self.responsibility)
        self._estimate_outside()
        counts = self.transitions()
        self.monitor.report(counts.sum(axis=1))
        return self.hazards(counts)

    def learn_speed(self, hazard: Singles) -> Singles:
        """Estimate from the surest candidates how far speed persists, and adjust all candidates.

        Return the hazards (P, bins) by the adjusted lags; ``hazard`` (P, bins) are those before.
        Which candidates are sure is decided without the agreement of slownesses, as agreement would
        otherwise reinforce itself.
        """
        before = self._at_exit()

        # The surest candidates, whatever their slownesses.
        self.adjustment = self.adjustment._replace(agreement=None)
        self.expect(hazard)
        sure = np.flatnonzero(self.responsibility > SURE_RESPONSIBILITY)
        c = self.candidates
        persistence = estimate_persistence(
            self.problem.departures.slow.take(c.departure[sure]),
            self.problem.arrivals.slow.take(c.arrival[sure]),
            c.lag[sure].astype(float),
            c.pair[sure],
            self.responsibility[sure].astype(float),
        )
        persistence = persistence._replace(label=self._label_persistence(sure))

        self.adjustment = adjust(self.problem, c, persistence)
        return self.hazards(self._count(before))

    def _label_persistence(self, sure: Indices) -> float:
        """Estimate how far labels persist from the candidates ``sure``; 0 without labels."""
        d, a, c = self.problem.departures, self.problem.arrivals, self.candidates
        if d.label is None or a.label is None or a.label_share is None:
            return 0.0
        exit_label, entry_label = d.label.take(c.departure[sure]), a.label.take(c.arrival[sure])
        label_rows = np.flatnonzero((exit_label >= 0) & (entry_label >= 0))
        return estimate_label_persistence(
            (exit_label == entry_label)[label_rows],
            a.label_share.take(c.arrival[sure[label_rows]]),
            self.responsibility[sure[label_rows]].astype(float),
        )

    def keep(self, mask: Bools) -> Bools:
        """Drop all candidates but those of a mask (M,), and pairs of zones without any.

        Return a mask (P,) of the pairs that are left. The entry kernels have to be made anew.
        """
        pair = self.candidates.pair[mask]
        pair_mask = np.bincount(pair, minlength=self.pairs) > 0
        self.adjustment = self.adjustment.take(np.flatnonzero(mask))
        self.adjustment.cell[:] -= np.cumsum(~pair_mask).take(pair) * self.problem.bins.size
        self._use(self.candidates.take(mask))
        self._message = self._message[mask]
        self.responsibility = self.responsibility[mask]
        self.own_share = self.own_share[pair_mask]
        return pair_mask

    def responsibilities_under(
        self, hazard: Singles, outside: Floats, contribution: Floats | float = 0.0
    ) -> Floats:
        """Return the responsibilities (M,) under given hazards, after `SWEEPS` sweeps of messages.

        hazard (P, bins): the hazards.
        outside (zones,): share of the arrivals that no departure explains.
        contribution (M,): responsibilities with which the candidates have contributed to the
            hazards, and which are left out of them (`expect`); 0 for hazards of other events.
        """
        self.outside = outside
        self._message[:] = 1.0
        for _ in range(SWEEPS):
            self.responsibility[:] = contribution
            self.expect(hazard)
        return self.responsibility.astype(float)

    # --- Candidates -------------------------------------------------------------------------------

    def summed(self, index: Indices, size: int) -> Floats:
        """Return the sum of responsibilities by group of candidates, (size,).

        index (M,): group of each candidate, such as its pair of zones, from 0 to ``size`` - 1.
        """
        return np.bincount(index, self.responsibility, minlength=size).astype(float, copy=False)

    def transitions(self) -> Floats:
        """Return the expected transitions (P, bins), without those of the entry kernels."""
        return self._count(self._at_exit())

    def _at_exit(self) -> Singles:
        """Return the responsibilities (M,) without the shares of the entry kernels."""
        at_exit = self.responsibility.copy()
        if self.model.kernels is not None:
            at_exit[self.model.kernels.rows] *= np.maximum(1.0 - self.model.kernels.share, 0.0)
        return at_exit

    # --- Rates ------------------------------------------------------------------------------------

    def _rates(self, hazard: Singles) -> Singles:
        """Return the rate of each candidate, 1/s, as the other candidates make it, (M,).

        hazard (P, bins): the hazards.
        """
        # The hazard, without the candidate's own contribution to it (leave one out): otherwise a
        # lone arrival would be its own evidence, and all clutter would find a departure.
        weight: Singles = np.empty(len(self.responsibility), np.float32)
        agreement = self.adjustment.agreement
        for rows, _ in self._parts:
            cell = self.adjustment.cell[rows]
            weight[rows] = hazard.take(cell) * np.maximum(
                1.0 - self.own_share.take(cell) * self.responsibility[rows], 0.0
            )
        if agreement is not None:
            weight *= agreement

        # The rates of the entry kernels, and their share in the sum.
        kernels = self.model.kernels
        if kernels is not None:
            rates = kernels.rates(self.responsibility.take(kernels.rows))
            if agreement is not None:
                rates *= agreement.take(kernels.rows)
            weight[kernels.rows] += rates
            kernels.share = rates / np.maximum(weight.take(kernels.rows), NOTHING)

        if self.model.multiplier is not None:
            weight *= self.model.multiplier
        if self._favour is not None:
            weight *= self._favour
        return weight

    def _leaving(self, hazard: Singles) -> Floats:
        """Return the probability (n,) that the object of each departure leaves the site.

        hazard (P, bins): the hazards, by which an object appears again or not.
        """
        if self.model.leave is not None:
            return self.model.leave
        share = np.zeros(self.pairs)
        for rows in row_slices(self.pairs):
            able = self._able_share[self.range_of[rows]]
            share[rows] = (hazard[rows] * self.problem.bins.widths * able).sum(axis=1)
        of_zone = np.bincount(self.candidates.source, share, minlength=self.problem.zones)
        again = of_zone.astype(float)[self.problem.departures.zone]
        leave: Floats = np.maximum(1.0 - again, LEAVE_FLOOR)
        return leave

    # --- Counts -----------------------------------------------------------------------------------

    def _estimate_outside(self) -> None:
        """Estimate the share of each zone's arrivals that no departure explains (`outside`)."""
        zone = self.problem.arrivals.zone[self._arrival_rows]
        responsibility_sums = np.add.reduceat(self.responsibility, self._first, dtype=float)
        of_zone = np.bincount(zone, responsibility_sums, minlength=self.problem.zones)
        self.outside = np.clip(1.0 - of_zone / self.arrivals_of_zone, OUTSIDE_FLOOR, 1.0)

    def _count(self, shares: Singles) -> Floats:
        """Return the sum of shares (M,) of candidates by pair of zones and lag bin, (P, bins)."""
        size = self.problem.bins.size
        counts = np.bincount(self.adjustment.cell, shares, minlength=self.pairs * size)
        return counts.astype(float, copy=False).reshape(self.pairs, size)

    def hazards(self, counts: Floats) -> Singles:
        """Return the hazards (P, bins) that follow from counted transitions.

        counts (P, bins): expected transitions by pair of zones and lag bin.

        Hazards are the smoothed counts over exposure and width of the bin. A prior adds to both, as
        if every path were taken equally in both directions.
        """
        prior = self.model.prior
        pseudo_count = 0.0 if prior is None else prior.departures(counts.sum(axis=1))
        smooth_counts = self._smoothed(counts)
        del counts  # larger than the hazards

        hazard = np.empty_like(smooth_counts)
        for rows in row_slices(self.pairs):
            transitions: Floats | Singles = smooth_counts[rows]
            if prior is not None:
                back = prior.back[rows]
                rates = smooth_counts[back] / self._exposure_of_pairs(back)
                transitions = transitions + pseudo_count * np.where(back[:, None] < 0, 0.0, rates)
            departures = self._exposure_of_pairs(rows) + pseudo_count
            hazard[rows] = transitions / (departures * self.problem.bins.widths)
        return hazard

    def _smoothed(self, counts: Floats) -> Singles:
        """Return the counts (P, bins) less the sparse prior, smoothed; set `own` to match."""
        total = counts.sum(axis=1)
        sparse_total = np.maximum(total - self.model.sparsity, 1e-3 * total)
        share = (sparse_total / np.maximum(total, 1e-300))[:, None]
        result = np.empty(counts.shape, np.float32)
        for rows in row_slices(self.pairs):
            smoothed_part, stays = smooth(counts[rows], sparse_total[rows])
            result[rows] = smoothed_part = smoothed_part * share[rows]
            self.own_share[rows] = stays[:, None] / np.maximum(smoothed_part, NOTHING)
        return result

    def _exposure_of_pairs(self, rows: slice | Indices) -> Floats:
        """Return the exposed departures (pairs, bins) of the pairs ``rows``, at least 1."""
        return self.exposure_at_least_one.take(self.range_of[rows], axis=0)
