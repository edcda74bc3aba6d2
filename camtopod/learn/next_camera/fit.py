"""The fit for prediction: where objects appear next, all weak evidence included (METHOD 10).

It extends EM over candidates (`association.em.Em`) by entry kernels, a prior over pairs of zones,
contexts of departures, and the spurious share of each pair; the head of the package names
their modules. `fit_window` runs it, with the methods of `PosteriorFitter` in the order of the
steps, and goes on to the links.

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
    ConvergenceMonitor,
    Em,
    EmModel,
    Fit,
    Problem,
    fit_sparsely,
    negative_without_overlap,
    result,
)
from camtopod.learn.lags import CLEAR_NOISE_SD
from camtopod.learn.links import FAINT_TRANSITIONS, LinkTable
from camtopod.learn.next_camera.contexts import ContextCounts, ContextLevel, Contexts, multipliers
from camtopod.learn.next_camera.entry_kernels import EntryKernels
from camtopod.learn.next_camera.prior import Prior
from camtopod.learn.next_camera.spurious import (
    CHANCE_PRIOR,
    any_link_probability,
    spurious_shares,
)
from camtopod.topology import LEAVE_FLOOR

FIRST_ROUNDS = 3
"""Rounds of EM without contexts; after each round, unlikely candidates are left out and speed is
estimated.
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


def fit_window(
    problem: Problem, candidates: Candidates, overlap: NDArray[np.bool_]
) -> tuple[Posterior, Fit]:
    """Fit which departure and which arrival are of one object; return the posterior and the links.

    overlap (cameras, cameras): True where two views are known to overlap.

    The second result goes on from the first one, with a sparse prior (`fit_sparsely`), as a link
    has to be significant. The posterior has no `Posterior.doubt` yet.

    Every fit begins from nothing, as a fit that starts from the last window reinforces early
    mistakes.
    """
    fitter = PosteriorFitter(problem, candidates)
    del candidates  # most of them are given up early
    fitter.learn(overlap)
    posterior = fitter.posterior()
    return posterior, fit_sparsely(fitter.em)


def with_doubt(posterior: Posterior, problem: Problem, between: LinkTable) -> Posterior:
    """Return a posterior with the spurious share of each pair of zones.

    between: pairs of zones with their held-out evidence (`link_evidence`).
    """
    departures = np.bincount(problem.departures.zone, minlength=problem.zones).astype(float)
    any_link = any_link_probability(between.ratio, departures)
    fit = posterior.fit
    c = fit.candidates
    evidence = between.evidence_of(c.source, c.target)
    camera = problem.cameras()
    returns = camera[c.source] == camera[c.target]
    odds = problem.odds_of(c.source, c.target)
    chance = CHANCE_PRIOR / (np.ones(len(c.source)) if odds is None else odds)
    doubt = spurious_shares(c.pair, fit.responsibility, evidence, any_link, returns, chance)
    return posterior._replace(doubt=doubt)


class PosteriorFitter:
    """The fit for prediction in progress: EM (`em`), the additions to it, and the steps around it.

    share (P,), leave (zones,): as in `Posterior`; the present estimates.
    contexts: contexts of all departures.
    entry_kernels: rates by the time since the entry, in overlapping views.
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
        self.entry_kernels = EntryKernels(self.problem, em.candidates, self.contexts.entry)
        prior = Prior(em.candidates, em.range_of, self.problem.zones)
        em.model = EmModel(kernels=self.entry_kernels, prior=prior)

    def learn(self, overlap: NDArray[np.bool_]) -> None:
        """Run the fit: rounds without contexts, then iterations with contexts.

        overlap (cameras, cameras): True where two views are known to overlap.
        """
        # First hazards and entry kernels, from the excess over the null model.
        self.entry_kernels.start(CLEAR_NOISE_SD)
        self.hazard = self.em.start(CLEAR_NOISE_SD)
        if self.problem.arrivals.label is not None:
            self.em.learn_speed(self.hazard)
            self.hazard = self.em.start(CLEAR_NOISE_SD)

        # Rounds without contexts; impossible candidates are left out as soon as they show.
        for before in range(FIRST_ROUNDS):
            self._iterate(contexts=False)
            self._keep(self.em.live() if before else self._possible(overlap))
            self.hazard = self.em.learn_speed(self.hazard)
        self._iterate(contexts=True)

    def _possible(self, overlap: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask (M,) of the candidates that are neither unlikely nor impossible."""
        em = self.em
        impossible = negative_without_overlap(
            self.problem, em.candidates, em.responsibility, overlap
        )
        return em.live() & ~impossible

    def _keep(self, mask: NDArray[np.bool_]) -> None:
        """Leave out all candidates but those of a mask (M,) from here on."""
        em = self.em
        share = np.zeros(len(mask))
        share[self.entry_kernels.rows] = self.entry_kernels.share
        self.hazard = self.hazard[em.keep(mask)]
        self._extend()
        self.entry_kernels.share = share[mask][self.entry_kernels.rows]
        self.entry_kernels.learn(em.responsibility)

    def posterior(self) -> Posterior:
        """Return the result of the fit, without doubt."""
        em = self.em
        levels = [counts.published() for counts in self._count_contexts()]
        bare_posterior = result(
            em, self.hazard, np.zeros((0, self.problem.bins.size))
        )  # without counts
        return Posterior(
            bare_posterior,
            self.share,
            self.leave,
            np.zeros(em.pairs),
            self.entry_kernels.source,
            self.entry_kernels.target,
            self.entry_kernels.kernels(em.responsibility),
            self.problem.delays(em.candidates.source, em.candidates.target),
            levels,
        )

    def _iterate(self, contexts: bool) -> None:
        """Run EM; with ``contexts``, estimate contexts after every other iteration."""
        self.em.monitor = ConvergenceMonitor()
        for iteration in self.em.monitor:
            self.em.expect(self.hazard)
            self.hazard = self.em.maximise()
            if contexts:
                self.hazard = self._with_faint()
                if iteration % 2 == 0:
                    self._learn_contexts()

    def _with_faint(self) -> Singles:
        """Return the hazards (P, bins) with `FAINT_TRANSITIONS` of every pair of zones added.

        They are spread evenly over the lag bins after the exit. With little data a converged fit is
        overconfident, as it reinforces its own first guesses.
        """
        em = self.em
        bins = self.problem.bins
        after = bins.edges[1:] > 0
        faint = FAINT_TRANSITIONS * after / (after.sum() * bins.widths)
        faint_departures = FAINT_TRANSITIONS * np.bincount(em.range_of, minlength=len(em.exposure))

        hazard = np.empty_like(self.hazard)
        for rows in row_slices(em.pairs):
            at = em.range_of[rows]
            exposure = em.exposure_at_least_one[at]
            hazard[rows] = (self.hazard[rows] * exposure + faint) / (
                exposure + faint_departures[at][:, None]
            )
        return hazard

    def _learn_contexts(self) -> None:
        """Estimate the factor on each candidate's rate by the context of its departure."""
        em = self.em
        context_counts = self._count_contexts()
        after = self.contexts.judged(em.candidates, em.responsibility, self.share, context_counts)
        before = self.share.astype(np.float32).take(em.candidates.pair)
        em.model = em.model._replace(multiplier=multipliers(before, after))

    def _count_contexts(self) -> list[ContextCounts]:
        """Estimate `share` and `leave`, and return departures and transitions by context."""
        em = self.em
        c = self.em.candidates
        zone = self.problem.departures.zone
        departures_of_source = np.maximum(self._departures_of, 1e-9)

        # Shares of the departures of each zone: by next zone, and those that leave the site.
        self.share = em.summed(c.pair, em.pairs) / departures_of_source[c.source]
        seen_again = em.summed(c.departure, len(zone))
        absence = 1.0 - np.minimum(seen_again, 1.0)
        leave = np.bincount(zone, absence, minlength=self.problem.zones) / departures_of_source
        self.leave = np.maximum(leave, LEAVE_FLOOR)

        # Shares by context.
        context_counts, leave_of_departure = self.contexts.count(
            c, em.responsibility, absence, self.leave[zone]
        )
        em.model = em.model._replace(leave=np.maximum(leave_of_departure, LEAVE_FLOOR))
        return context_counts
