"""The fit for prediction: where objects appear next, all weak evidence included (METHOD 10).

It extends EM over candidates (`association.em.Em`) by entry kernels, a prior over pairs of zones,
contexts of departures, and the spurious share of each pair; the head of the package names
their modules. `followed_of` selects the candidates with a few iterations,
`fit_followed` runs the whole fit; both use `PosteriorFitter`, whose methods are in the order of the
steps.

Entry kernels and hazards both start from the excess over the null model. If only hazards did, then
where one view ends as another begins, departures from the former would be credited with arrivals in
the latter that belong to a view overlapping both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Ints, Singles, row_slices
from camtopod.learn.association import (
    Candidates,
    Em,
    EmModel,
    Fit,
    Problem,
    negative_without_overlap,
    result,
)
from camtopod.learn.next_camera.contexts import ContextCounts, ContextLevel, Contexts, multipliers
from camtopod.learn.next_camera.entry_kernels import EntryKernels
from camtopod.learn.next_camera.prior import Prior
from camtopod.learn.next_camera.spurious import spurious_shares
from camtopod.topology import LEAVE_FLOOR

FIRST_NOISE_SD = 3.0
"""Standard deviations of the null model that are subtracted from lag histograms for first hazards.
"""
FIRST_ROUNDS = 3
FIRST_ITERATIONS = 5
"""Rounds without contexts, and EM iterations of each (and of `followed_of`); after each round,
unlikely candidates are left out and speed is estimated.
"""
NEGLIGIBLE = 1e-4
"""Least responsibility, after these iterations, of a candidate that is selected."""
ITERATIONS = 8
"""EM iterations with contexts; contexts are estimated after every other one."""
FAINT_TRANSITIONS = 0.2
"""Transitions of every pair of zones that are added in iterations with contexts, spread evenly over
the lag bins after the exit. With little data a converged fit is overconfident, as it reinforces its
own first guesses.
"""


class Posterior(NamedTuple):
    """Result of the fit for prediction: P pairs of zones and Q entry kernels."""

    fit: Fit
    """Candidates, pairs of zones, responsibilities, and hazards by lag from the exit; without
    counts.
    """
    share: Floats
    """(P,) share of the departures at the source that appear next at the target."""
    leave: Floats
    """(zones,) share of the departures that leave the site."""
    doubt: Floats
    """(P,) spurious share of the transitions of each pair (`spurious`)."""
    entry_source: Ints
    """(Q,) zone of entry of each entry kernel."""
    entry_target: Ints
    """(Q,) zone of the next appearance of each entry kernel."""
    entry_hazard: Floats
    """(Q, bins) entry kernels by time from the entry, per second and passage still in view."""
    delay: Floats
    """(P,) seconds to add to the lags of each pair's hazards (`long_paths`)."""
    levels: list[ContextLevel]
    """Departures and transitions by context, one table for each of `contexts.LEVELS`."""


def followed_of(
    problem: Problem, candidates: Candidates, overlapping: NDArray[np.bool_]
) -> tuple[Candidates, NDArray[np.bool_]]:
    """Return the candidates that are worth using in fits, and which of them are possible, (n,).

    overlapping (cameras, cameras): True where two views are known to overlap.
    """
    scout = PosteriorFitter(problem, candidates)
    scout.scout()
    em = scout.em
    likely = (em.responsibility > NEGLIGIBLE) & em.live()
    impossible = negative_without_overlap(problem, candidates, em.responsibility, overlapping)
    return candidates.take(likely), ~impossible[likely]


def fit_followed(problem: Problem, followed: Candidates, evidence: Floats) -> Posterior:
    """Fit the posterior of the selected candidates.

    followed: result of `followed_of`.
    evidence (k, nats): held-out evidence of k pairs of zones (`cross_evidence`).

    Every fit begins from nothing, as a fit that starts from the last one reinforces early mistakes.
    """
    fitter = PosteriorFitter(problem, followed)
    fitter.learn()
    return fitter.posterior(evidence)


class PosteriorFitter:
    """The fit for prediction in progress: EM (`em`), the additions to it, and the steps around it.

    share (P,), leave (zones,): as in `Posterior`; the present estimates.
    contexts: contexts of all departures.
    entering: the entry kernels.
    """

    def __init__(self, problem: Problem, candidates: Candidates) -> None:
        """Begin without responsibilities."""
        departures, _, bins, zones, *_ = problem
        self.problem = problem
        self.em = em = Em(problem, candidates)
        self.hazard: Singles = np.zeros((em.pairs, bins.size), np.float32)
        """(P, bins) hazards by lag from the exit."""
        self._departures_of = np.bincount(departures.zone, minlength=zones).astype(float)
        self.share = np.zeros(em.pairs)
        self.leave = np.ones(zones)

        # Contexts, and the entry kernels and the prior of the EM model.
        cameras = int(em.camera.max(initial=0)) + 1
        self.contexts = Contexts(problem, cameras)
        self._extend()

    def _extend(self) -> None:
        """Give the EM model its entry kernels and prior, for the present candidates."""
        em = self.em
        self.entering = EntryKernels(self.problem, em.candidates, self.contexts.entry)
        prior = Prior(em.candidates, em.range_of, self.problem.zones)
        em.assume(EmModel(entering=self.entering, prior=prior))

    def scout(self) -> None:
        """Run a few iterations, enough for `followed_of`."""
        self._start()
        self._iterate(FIRST_ITERATIONS, contexts=False)

    def learn(self) -> None:
        """Run the fit: rounds without contexts, then iterations with contexts."""
        self._start()
        for _ in range(FIRST_ROUNDS):
            self._iterate(FIRST_ITERATIONS, contexts=False)
            self._keep_live()
            self.hazard = self.em.learn_speed(self.hazard)
        self._iterate(ITERATIONS, contexts=True)

    def _keep_live(self) -> None:
        """Leave out unlikely candidates from here on."""
        em = self.em
        live = em.live()
        share = np.zeros(len(live))
        share[self.entering.rows] = self.entering.share
        self.hazard = self.hazard[em.keep(live)]
        self._extend()
        self.entering.share = share[live][self.entering.rows]
        self.entering.learn(em.responsibility)

    def posterior(self, evidence: Floats) -> Posterior:
        """Return the result of the fit, which is over with this.

        evidence (k, nats): held-out evidence of k pairs of zones (`cross_evidence`).
        """
        em = self.em
        levels = self.contexts.published_levels(em.candidates, self._count_contexts())
        found = result(em, self.hazard, np.zeros((0, self.problem.bins.size)))  # without counts
        doubt = spurious_shares(
            em.candidates.pair, found.responsibility, em.pairs, evidence, self._departures_of
        )
        return Posterior(
            found,
            self.share,
            self.leave,
            doubt,
            self.entering.source,
            self.entering.target,
            self.entering.kernels(em.responsibility),
            self.problem.delays(em.candidates.source, em.candidates.target),
            levels,
        )

    def _start(self) -> None:
        """Set the first hazards and entry kernels, from the excess over the null model."""
        self.entering.start(FIRST_NOISE_SD)
        self.hazard = self.em.start(FIRST_NOISE_SD)

    def _iterate(self, iterations: int, contexts: bool) -> None:
        """Run EM iterations; with ``contexts``, estimate contexts after every other one."""
        for iteration in range(iterations):
            self.em.expect(self.hazard)
            self.hazard = self.em.maximise()
            if contexts:
                self.hazard = self._with_faint()
                if iteration % 2 == 0:
                    self._learn_contexts()

    def _with_faint(self) -> Singles:
        """Return the hazards (P, bins) with `FAINT_TRANSITIONS` of every pair of zones added."""
        em = self.em
        bins = self.problem.bins
        after = bins.edges[1:] > 0
        faint = FAINT_TRANSITIONS * after / (after.sum() * bins.widths)
        more = FAINT_TRANSITIONS * np.bincount(em.range_of, minlength=len(em.exposure))

        hazard = np.empty_like(self.hazard)
        for rows in row_slices(em.pairs):
            at = em.range_of[rows]
            exposed = em.exposure_at_least_one[at]
            hazard[rows] = (self.hazard[rows] * exposed + faint) / (exposed + more[at][:, None])
        return hazard

    def _learn_contexts(self) -> None:
        """Estimate the factor on each candidate's rate by the context of its departure."""
        em = self.em
        counted = self._count_contexts()
        after = self.contexts.judged(em.candidates, em.responsibility, self.share, counted)
        before = self.share.astype(np.float32).take(em.candidates.pair)
        em.assume(em.model._replace(multiplier=multipliers(before, after)))

    def _count_contexts(self) -> list[ContextCounts]:
        """Estimate `share` and `leave`, and return departures and transitions by context."""
        em = self.em
        c = self.em.candidates
        zone = self.problem.departures.zone
        departures_of_source = np.maximum(self._departures_of, 1e-9)

        # Shares of the departures of each zone: by next zone, and those that leave the site.
        self.share = em.summed(c.pair, em.pairs) / departures_of_source[c.source]
        seen_again = em.summed(c.departure, len(zone))
        gone = 1.0 - np.minimum(seen_again, 1.0)
        leave = np.bincount(zone, gone, minlength=self.problem.zones) / departures_of_source
        self.leave = np.maximum(leave, LEAVE_FLOOR)

        # Shares by context.
        counted, leaving = self.contexts.count(c, em.responsibility, gone, self.leave[zone])
        em.assume(em.model._replace(leaving=np.maximum(leaving, LEAVE_FLOOR)))
        return counted
