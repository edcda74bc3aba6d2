"""Held-out evidence for links (METHOD 7): one half of the window is judged by a fit of the other.

The window is cut into stretches of time, which are assigned in turn to two halves. The hazards of
all pairs of zones are fitted from scratch on one half and bet on the other: how much better are its
arrivals predicted with the pair than without it?

If two zones are unrelated, this likelihood ratio has a mean of at most 1, whatever the shape of the
fit (Shafer and others, Statistical Science 26(1), 2011). Another comes from the halves exchanged.
The mean of both is an e-value, from which false discovery rates follow (Wang and Ramdas 2022). The
bound is approximate, as the likelihood approximates the competition for departures and the rates of
the null model.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, Longs, Singles
from camtopod.learn.association import (
    RESPONSIBILITY_MAX,
    SPARSITY,
    Candidates,
    Em,
    EmModel,
    Fit,
    Problem,
    adjust,
    candidates_of_pairs,
    flatness,
)
from camtopod.learn.links.common_cycle import (
    evidence_against_cycle,
    off_cycle,
)
from camtopod.learn.links.link_table import TRANSITIONS_MIN
from camtopod.learn.links.significance import (
    evidence_against_untimed,
    repeated,
    repeated_evidence,
)
from camtopod.learn.traffic import activity_rates

STRETCH_LAGS = 16.0
"""Length of a stretch, in multiples of the longest transit time, unless the window is too short."""
OUTSIDE_LEAST = 0.5
"""Least share of the local rate of arrivals that counts as from outside when a bet is judged."""


class LinkEvidence(NamedTuple):
    """Evidence (P, nats) that the zones of each pair of a fit are linked.

    It is a log likelihood ratio against two null models, of which the stronger one counts (the
    smaller ratio): the zones are unrelated; or arrivals at one zone follow departures from the
    other at no particular lag, as when both zones follow a rhythm. Where the zones have a common
    cycle, this takes the place of the first model (`common_cycle`), and of both in ``whole``.
    """

    held_out: Floats
    """(P,) each half of the window by a fit of the other."""
    whole: Floats
    """(P,) the whole window, each candidate left out of its own prediction."""

    @property
    def both(self) -> Floats:
        """(P,) the geometric mean of the two as e-values, which is one."""
        mean: Floats = 0.5 * (self.held_out + self.whole)
        return mean


def link_evidence(problem: Problem, fit: Fit, first: float, period: Floats) -> LinkEvidence:
    """Return the evidence that the zones of each pair of a fit are linked.

    first (seconds): beginning of the window.
    period (P, seconds): common period of each pair of zones, nan without one.
    """
    judge = judging(problem)
    return LinkEvidence(_held_out(problem, judge, fit, first, period), _whole(judge, fit, period))


def judging(problem: Problem) -> Problem:
    """Return a problem under the null model that judges links.

    Arrivals may also follow the activity of the site (`activity_rates`), and what was declared of
    the cameras (`Problem.odds`) does not count: it may shape a fit, but does not judge it.
    """
    arrivals = problem.arrivals
    active = activity_rates(arrivals.t, arrivals.zone, arrivals.camera, arrivals.rate)
    return problem._replace(arrivals=arrivals._replace(rate=active), odds=None)


def _whole(problem: Problem, fit: Fit, period: Floats) -> Floats:
    """Return the evidence (P, nats) of the whole window under the null model of a problem.

    fit: the joint fit, whose hazards are judged.
    period (P, seconds): common period of each pair of zones, nan without one.
    """
    c = fit.candidates
    em = Em(problem, c, EmModel(sparsity=SPARSITY), None, adjust(problem, c, fit.persistence))
    em.responsibility = fit.responsibility.astype(np.float32)
    hazard = em.hazards(em.transitions())
    outside = np.maximum(fit.outside, OUTSIDE_LEAST)
    share = em.responsibilities_under(hazard, outside, fit.responsibility)
    at = c.arrival / max(len(problem.arrivals.t), 1)
    evidence = repeated_evidence(c.pair, share, flatness(em, hazard), at, em.pairs)
    cycle = evidence_against_cycle(problem, c, hazard, share, em.outside, period)
    return np.where(period > 0.0, repeated(cycle), evidence)


def _held_out(problem: Problem, judge: Problem, fit: Fit, first: float, period: Floats) -> Floats:
    """Return the held-out evidence (P, nats) that the zones of each pair of a fit are linked.

    judge: the problem as the bets are judged (`judging`).
    fit: the joint fit of the whole window, for its pairs of zones; its hazards are not used. Of the
        pairs that may be links, all candidates count, as the likely ones alone are biased.
    first (seconds): beginning of the window.
    period (P, seconds): common period of each pair of zones, nan without one.
    """
    pairs = np.flatnonzero(fit.counts.sum(axis=1) >= TRANSITIONS_MIN)
    candidates = candidates_of_pairs(problem, fit.candidates, pairs)
    candidates = candidates.rows(off_cycle(problem, candidates, period))
    halves = Halves(problem, judge, fit._replace(candidates=candidates), first)
    mean: Floats = np.logaddexp(_bet(halves, 0, period), _bet(halves, 1, period)) - np.log(2.0)
    return mean


def _bet(halves: Halves, half: int, period: Floats) -> Floats:
    """Return the log (P, nats) of what a bet of half of the stake makes of the stake.

    A bet that loses everything then costs ln 2 nats, not hundreds.

    half: the half that the hazards are fitted on; they bet on the other one.

    period (P, seconds): common period of each pair of zones, nan without one.

    The bet is against the stronger of the two null models.
    """
    fitter = halves.take(half)
    hazard = _fitted(fitter)
    # What is left when a pair is taken away must be as good as knowing nothing. On noise, the pairs
    # explain nearly all arrivals, and each would look needed beside so small a rest.
    outside = np.maximum(fitter.outside, OUTSIDE_LEAST)
    judge = halves.take(1 - half, for_judging=True)
    ratio = np.minimum(*_evidence(judge, hazard, outside, period))
    stake: Floats = np.logaddexp(ratio, 0.0) - np.log(2.0)
    return stake


class Halves:
    """The two halves of a window, each with its exposure.

    Arguments are as for `_held_out`.
    """

    def __init__(self, problem: Problem, judge: Problem, fit: Fit, first: float) -> None:
        self.problem = problem
        self._judge_problem = judge
        self.fit = fit
        self.first = first

        # Length of the stretches, seconds.
        span = max(problem.until - first, 1.0)
        self.stretch = min(STRETCH_LAGS * problem.bins.lag_max, 0.5 * span)

        # Half of each event, exposure of each half, and the speed-adjusted candidates.
        self._departure_half = self._of(problem.departures.t)
        self._arrival_half = self._of(problem.arrivals.t)
        self._exposure = self._exposures()
        self._adjustment = adjust(problem, fit.candidates, fit.persistence)

    def take(self, half: int, for_judging: bool = False) -> Em:
        """Return a fit in progress of the arrivals in one half; pairs are numbered as in `fit`.

        half: its number, 0 or 1.
        for_judging: True for the half that is bet on (`judging`).
        """
        # Keep the candidates whose arrivals lie in this half.
        departs = self._departure_half == half
        arrives = self._arrival_half == half
        c = self.fit.candidates
        rows = np.flatnonzero(arrives[c.arrival])
        arrival = (np.cumsum(arrives) - 1).astype(np.int32)
        candidates = Candidates(
            c.departure[rows],
            arrival[c.arrival[rows]],
            c.pair[rows],
            c.lag[rows],
            c.source,
            c.target,
        )

        problem = self._judge_problem if for_judging else self.problem
        return Em(
            problem._replace(arrivals=problem.arrivals.take(arrives)),
            candidates,
            EmModel(near=departs if departs.any() else slice(None)),
            self._exposure[half],
            self._adjustment.take(rows),
        )

    def _of(self, t: Floats) -> Longs:
        """Return the number of the half (n,) in which each of the times (n, seconds) lies."""
        half: Longs = np.floor((t - self.first) / self.stretch).astype(np.int64) % 2
        return half

    def _exposures(self) -> Floats:
        """Return the exposed departures of each range of lags by half and bin, (2, R, bins).

        A departure counts for the half in which an arrival after the lag would lie, if it is
        exposed to the lag. With the exposure of the whole window instead, short lags would look
        like links: an arrival after a short lag is often in the departure's own half.
        """
        bins = self.problem.bins
        number, t, since = self.problem.delayed_departures()
        ranges = self.problem.range_count
        result = np.zeros((2, ranges, bins.size))
        for k, centre in enumerate(bins.centres):
            if bins.edges[k + 1] <= 0:
                exposure = np.clip((bins.edges[k + 1] + t - since) / bins.widths[k], 0.0, 1.0)
            else:
                exposure = (self.problem.until - t >= bins.edges[k + 1]).astype(float)
            cell = self._of(t + centre) * ranges + number
            counts = np.bincount(cell, exposure, minlength=2 * ranges)
            result[:, :, k] = counts.reshape(2, ranges)
        return result


def _fitted(fitter: Em) -> Singles:
    """Return hazards (P, bins) fitted from scratch, with the sparse prior in the last run only.

    Half of the window has half of the transitions, so the prior takes off half as many, too.
    """
    hazard = fitter.run(fitter.start())
    fitter.model = fitter.model._replace(sparsity=SPARSITY / 2)
    result = np.zeros_like(hazard)
    pair_mask = fitter.keep(fitter.live())
    result[pair_mask] = fitter.run(hazard[pair_mask])
    return result


def _evidence(
    fitter: Em, hazard: Singles, outside: Floats, period: Floats
) -> tuple[Floats, Floats]:
    """Return the log likelihood ratio of each pair of zones against both null models, (P, nats).

    The first is against no link (or a common cycle), the second against one without a transit time.

    fitter: the held-out arrivals and their candidates.
    hazard (P, bins): hazards fitted on the other half.
    outside (zones,): share of the local rate of arrivals that no departure explains, from the same
        fit.
    period (P, seconds): as for `_bet`.
    """
    # Responsibilities of the held-out candidates under the given hazards.
    share = fitter.responsibilities_under(hazard, outside)
    share = np.minimum(share, RESPONSIBILITY_MAX)
    c = fitter.candidates

    # Point-process likelihood ratio against no link: arrivals explained, less arrivals expected.
    departure_seconds = fitter.exposure[fitter.range_of] * fitter.problem.bins.widths
    expected: Floats = (hazard * departure_seconds).sum(axis=1)
    against_unrelated: Floats = (
        np.bincount(c.pair, -np.log1p(-share), minlength=fitter.pairs) - expected
    )

    cycle = evidence_against_cycle(fitter.problem, c, hazard, share, outside, period)
    against_unrelated = np.where(period > 0.0, cycle.sum(axis=1), against_unrelated)

    # Likelihood ratio against the same number of transitions spread evenly over all lags.
    flat = flatness(fitter, hazard)
    return against_unrelated, evidence_against_untimed(c.pair, share, flat, fitter.pairs)
