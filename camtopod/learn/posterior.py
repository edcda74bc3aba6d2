"""The posterior for prediction: where objects go next, all weak evidence included.

What is published as a link must be beyond doubt; a prediction should use everything that is known, as far as it is.
Beside the hazards of the joint fit this one has

* *entry kernels*: where views overlap, an object often appears in the next view a certain time after it *entered* this
  one, whenever it will leave it. The hazard of an appearance before the exit is the sum of one that counts from the
  entry, by zone of entry, and one that counts from the exit. Both start from what exceeds chance: started from the exit
  alone, views that end where another begins would take each other's arrivals from the views between;
* *contexts* of a departure (`contexts`), and leaving the network as an outcome like the others;
* an *ensemble*: few events allow many explanations, and a single fit is sure of the one it fell into. So several are
  made, each weighing stretches of time at random (the Bayesian bootstrap; Rubin 1981), and averaged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.candidates import Arrivals, Candidates, Departures, excess
from camtopod.learn.contexts import Contexts, Level, mean_levels, multipliers
from camtopod.learn.joint import (
    LEAVE_FLOOR,
    OUTSIDE_FLOOR,
    POOLING_DEPARTURES,
    START_FLOOR,
    START_NOISE_SD,
    Fit,
    JointFitter,
    smooth,
)
from camtopod.learn.lags import LagBins
from camtopod.learn.rates import chance_rates
from camtopod.learn.significance import RESPONSIBILITY_MAX

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

MEMBERS_MAX = 4
MEMBER_CANDIDATES = 800_000
"""As many members are fitted as have this many candidates together: with more events, one is sure enough."""
STRETCHES = 60
"""Stretches of time that a member weighs."""
ENSEMBLE_SEED = 1981
FIRST_ROUNDS, FIRST_ITERATIONS = 3, 5
"""Of a fit from nothing, without contexts; speed is looked at after each."""
SCOUT_ITERATIONS = 5
OVERLAP_FALSE = 0.05
NEGLIGIBLE = 1e-3
"""Candidates with a smaller responsibility after the first few iterations are left out of the others."""
ROUNDS, ITERATIONS = 2, 4
"""With contexts; a fit that goes on from an earlier one has one round."""


class Kernels(NamedTuple):
    """Where one member stands: hazards counted from the exit (P, bins) and from the entry (Q, bins)."""

    exit: Floats
    entry: Floats


class Posterior(NamedTuple):
    """Means over the members."""

    fit: Fit
    """Pairs of zones, hazards counted from the exit, responsibilities."""
    share: Floats
    """(P,) of the departures at the source, those that appear next at the target."""
    leave: Floats
    """(zones,) of the departures, those not seen again."""
    entry_source: Ints
    """(Q,) zone of entry ..."""
    entry_target: Ints
    """(Q,) ... and zone of the next appearance."""
    entry_hazard: Floats
    """(Q, bins) per second and passage still in view, counted from the entry."""
    levels: list[Level]
    members: list[Kernels]
    """To go on from."""


def fit_posterior(
    departures: Departures, arrivals: Arrivals, candidates: Candidates, bins: LagBins, zones: int, until: float,
    known: Callable[[Candidates, Ints, Ints], list[Kernels]] | None = None,
) -> Posterior:  # fmt: skip
    """The posterior of everything that left and came up to ``until`` (seconds). ``known`` gives the members to go on
    from for the pairs of zones of candidates and those of entry kernels, (Q,) each.
    """
    scout = PosteriorFitter(departures, arrivals, candidates, bins, zones, until)
    before = known and known(candidates, scout.entry_source, scout.entry_target)
    candidates = scout.worth_following(before[0] if before else None)
    count = int(np.clip(MEMBER_CANDIDATES // max(len(candidates.lag), 1), 1, MEMBERS_MAX))
    fitters = [PosteriorFitter(departures, arrivals, candidates, bins, zones, until) for _ in range(count)]
    before = (known and known(candidates, fitters[0].entry_source, fitters[0].entry_target)) or []
    for member, fitter in enumerate(fitters):
        if count > 1:
            fitter.weigh(member)
        if member < len(before):
            fitter.go_on(before[member])
        else:
            fitter.begin()
    return _mean(fitters)


def _mean(fitters: list[PosteriorFitter]) -> Posterior:
    first = fitters[0]

    def mean(name: str) -> Floats:
        result: Floats = np.mean([getattr(fitter, name) for fitter in fitters], axis=0)
        return result

    hazard = mean("hazard")
    fit = Fit(
        hazard, mean("counts"), mean("responsibility"), first.flatness(hazard), mean("outside"), first.candidates,
        first.persistence,
    )  # fmt: skip
    return Posterior(
        fit, mean("share"), mean("leave"), first.entry_source, first.entry_target, mean("entry_hazard"),
        mean_levels([fitter.levels for fitter in fitters]),
        [Kernels(fitter.hazard, fitter.entry_hazard) for fitter in fitters],
    )  # fmt: skip


class PosteriorFitter(JointFitter):
    """One member in progress."""

    def __init__(
        self, departures: Departures, arrivals: Arrivals, candidates: Candidates, bins: LagBins, zones: int,
        until: float,
    ) -> None:  # fmt: skip
        super().__init__(departures, arrivals, candidates, bins, zones, until)
        self.pooling = POOLING_DEPARTURES
        self.hazard = self.counts = np.zeros((self.pairs, bins.size))
        self.share, self.leave, self.levels = np.zeros(self.pairs), np.ones(zones), list[Level]()
        self.contexts = Contexts(departures, arrivals, zones, int(self._camera.max(initial=0)) + 1)
        self._left = np.bincount(departures.zone, minlength=zones).astype(float)
        self._weight, self._counted = np.ones(len(departures.t)), np.ones(len(candidates.lag))
        self._leaving = np.zeros(0)  # (n,) of each departure, once contexts are known
        self._multiplier = np.ones(len(candidates.lag))
        self._find_early()

    @property
    def responsibility(self) -> Floats:
        """(M,)"""
        return self._responsibility

    def weigh(self, member: int) -> None:
        """Weigh stretches of time as a member of the ensemble does."""
        draw = np.random.default_rng((ENSEMBLE_SEED, member)).exponential(1.0, STRETCHES)
        draw /= draw.mean()
        t0, t1 = (edge(self.departures.t[end], self.arrivals.t[end]) for edge, end in ((min, 0), (max, -1)))
        at = [np.clip((t - t0) * STRETCHES / max(t1 - t0, 1e-9), 0, STRETCHES - 1).astype(int)
              for t in (self.departures.t, self.arrivals.t)]  # fmt: skip
        before, entered = self._left, np.bincount(self._entered, minlength=self.zones)
        self._weight, self._counted = draw[at[0]], draw[at[1]][self.candidates.arrival]
        self._left = np.bincount(self.departures.zone, self._weight, minlength=self.zones)
        self.exposure = self.exposure * (self._left / np.maximum(before, 1.0))[:, None]
        weighed = np.bincount(self._entered, self._weight[self.departures.own >= 0], minlength=self.zones)
        self._entry_exposure *= (weighed / np.maximum(entered, 1.0))[:, None]

    def worth_following(self, known: Kernels | None) -> Candidates:
        """The candidates that are not negligible after a few iterations."""
        self.entry_hazard, hazard = self._start_entry(), self.start()
        if known is not None:
            self.entry_hazard = np.maximum(known.entry, START_FLOOR * self.entry_hazard)
            hazard = np.maximum(known.exit, START_FLOOR * hazard)
        self._iterate(hazard, SCOUT_ITERATIONS, contexts=False)
        c = self.candidates
        kept = np.flatnonzero((self._responsibility > NEGLIGIBLE) & ~self._impossible())
        present, pair = np.unique(c.pair[kept], return_inverse=True)
        return Candidates(
            c.departure[kept], c.arrival[kept], pair.astype(np.int32), c.lag[kept], c.source[present], c.target[present]
        )

    def _impossible(self) -> NDArray[np.bool_]:
        """Candidates (M,) that appear before the exit in the view of a camera that shows no overlap with this one.

        Whether two views overlap is asked of all their zones, both ways, at once: how much better do appearances ahead
        of the exit predict arrivals than nothing does? By chance anywhere with a probability of `OVERLAP_FALSE`.
        """
        c, cameras = self.candidates, int(self._camera.max(initial=0)) + 1
        ahead = np.flatnonzero(c.lag < 0)
        left, came = self.departures.camera[c.departure[ahead]], self.arrivals.camera[c.arrival[ahead]]
        pair = np.minimum(left, came).astype(np.int64) * cameras + np.maximum(left, came)
        key, number = np.unique(c.arrival[ahead].astype(np.int64) * cameras + left, return_inverse=True)
        share = np.minimum(np.bincount(number, self._responsibility[ahead], minlength=len(key)), RESPONSIBILITY_MAX)
        of_key = np.zeros(len(key), np.int64)
        of_key[number] = pair
        nats = np.bincount(of_key, -np.log1p(-share) - share, minlength=cameras * cameras)
        overlapping = nats >= np.log(max(cameras * (cameras - 1) / 2, 1.0) / OVERLAP_FALSE)
        result = np.zeros(len(c.lag), bool)
        result[ahead] = ~overlapping[pair]
        return result

    def begin(self) -> None:
        """A fit from nothing."""
        self.entry_hazard, hazard = self._start_entry(), self.start()
        for _ in range(FIRST_ROUNDS):
            hazard = self._iterate(hazard, FIRST_ITERATIONS, contexts=False)
            hazard = self.use_slowness(self._as_fit(hazard))
        for _ in range(ROUNDS):
            hazard = self._iterate(hazard, ITERATIONS, contexts=True)

    def go_on(self, known: Kernels) -> None:
        """A fit that starts where an earlier one ended; what that did not know starts with a little of chance."""
        self.entry_hazard = np.maximum(known.entry, START_FLOOR * self._start_entry())
        hazard = np.maximum(known.exit, START_FLOOR * self.start())
        hazard = self._iterate(hazard, 1, contexts=False)
        hazard = self.use_slowness(self._as_fit(hazard))
        self._iterate(hazard, ITERATIONS, contexts=True)

    def _as_fit(self, hazard: Floats) -> Fit:
        nothing = np.zeros(0)
        return Fit(hazard, nothing, self._at_exit, nothing, self.outside, self.candidates, self.persistence)

    def _iterate(self, hazard: Floats, iterations: int, contexts: bool) -> Floats:
        for iteration in range(iterations):
            self._expect(hazard)
            self._at_exit = self._responsibility * self._counted
            self._at_exit[self._early] *= 1.0 - self._entry_part
            self._learn_entry()
            explained = np.bincount(self.candidates.arrival, self._responsibility, minlength=len(self.arrivals.t))
            per_zone = np.bincount(self.arrivals.zone, explained, minlength=self.zones)
            self.outside = np.clip(1.0 - per_zone / self._per_zone, OUTSIDE_FLOOR, 1.0)
            self.counts = self._count(self._at_exit)
            hazard = self._hazards(self.counts)
            if contexts and iteration % 2 == 0:
                self._learn_contexts()
        self.hazard = hazard
        return hazard

    def _weights(self, hazard: Floats) -> Floats:
        """Hazard (M,) of each candidate that the others make."""
        weight = super()._weights(hazard)
        own = self._responsibility[self._early] * self._entry_own[self._entry_cell]
        part = self.entry_hazard.ravel()[self._entry_cell] * np.maximum(1.0 - own, 0.0) * self._agreement[self._early]
        total = weight[self._early] + part
        self._entry_part = part / np.maximum(total, 1e-300)
        weight[self._early] = total
        weight *= self._multiplier
        return weight

    def _leave(self, hazard: Floats) -> Floats:
        return self._leaving if len(self._leaving) else super()._leave(hazard)

    def _learn_contexts(self) -> None:
        """Shares and leaving by zone, then by context."""
        c, zone, r = self.candidates, self.departures.zone, self._responsibility
        below = np.maximum(self._left, 1e-9)
        self.share = np.bincount(c.pair, r * self._counted, minlength=self.pairs) / below[c.source]
        gone = 1.0 - np.minimum(np.bincount(c.departure, r, minlength=len(zone)), 1.0)
        self.leave = np.maximum(np.bincount(zone, gone * self._weight, minlength=self.zones) / below, LEAVE_FLOOR)
        before = self.share[c.pair]
        self.levels, share, leaving = self.contexts.learn(
            c, r, before, gone, self.leave[zone], self._weight, self._counted
        )
        self._multiplier = multipliers(before, share)
        self._leaving = np.maximum(leaving, LEAVE_FLOOR)

    def _find_early(self) -> None:
        """The candidates that appear before the exit of a passage whose entry is known, and their place in the tables
        of entry kernels.
        """
        c, d, a, bins = self.candidates, self.departures, self.arrivals, self.bins
        early = np.flatnonzero((c.lag < 0) & (d.own[c.departure] >= 0))
        at = bins.index(a.t[c.arrival[early]] - d.since[c.departure[early]])
        early, at = early[at >= 0], at[at >= 0]
        entry = self.contexts.entry
        key = entry[c.departure[early]] * self.zones + a.zone[c.arrival[early]]
        present, number = np.unique(key, return_inverse=True)
        self._early = early
        self.entry_source = (present // max(self.zones, 1)).astype(np.int32)
        self.entry_target = (present % max(self.zones, 1)).astype(np.int32)
        self._entry_cell = number.astype(np.int64) * bins.size + at
        self._entry_own = np.zeros(len(present) * bins.size)
        self._entry_part = np.zeros(len(early))
        tied = d.own >= 0
        self._entered = entry[tied]
        stay = d.t[tied] - d.since[tied]
        self._entry_exposure = np.zeros((self.zones, bins.size))
        for zone in np.unique(self._entered):
            stays = np.sort(stay[self._entered == zone])
            self._entry_exposure[zone] = len(stays) - np.searchsorted(stays, bins.edges[:-1], side="left")

    def _start_entry(self) -> Floats:
        """First entry kernels (Q, bins): what exceeds chance."""
        d, a = self.departures, self.arrivals
        if len(self._early) == 0:
            return np.zeros((len(self.entry_source), self.bins.size))
        seen = self._count_entry(self._counted[self._early])
        exposed = self._entry_exposure[self.entry_source] * self.bins.widths
        tied = d.own >= 0
        began, zone = d.since[tied], self._entered.astype(np.int32)
        order = np.argsort(began, kind="stable")
        rates = chance_rates(began[order], zone[order], a.t, a.zone, self.zones)
        chance = rates[self.entry_source, self.entry_target][:, None] * exposed
        above = np.maximum(excess(seen, chance, self.bins, START_NOISE_SD), START_FLOOR * seen)
        first: Floats = above / np.maximum(exposed, self.bins.widths)
        return first

    def _count_entry(self, weight: Floats) -> Floats:
        size = len(self.entry_source) * self.bins.size
        flat: Floats = np.bincount(self._entry_cell, weight, minlength=size).astype(float)
        return flat.reshape(-1, self.bins.size)

    def _learn_entry(self) -> None:
        """M step of the entry kernels."""
        r = self._responsibility[self._early] * self._entry_part * self._counted[self._early]
        smoothed, stays = smooth(self._count_entry(r))
        self._entry_own = np.repeat(stays, self.bins.size) / np.maximum(smoothed.ravel(), 1e-300)
        exposed = np.maximum(self._entry_exposure[self.entry_source], 1.0)
        self.entry_hazard = smoothed / (exposed * self.bins.widths)
