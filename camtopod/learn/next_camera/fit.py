"""The posterior for prediction: where objects go next, all weak evidence included.

What is published as a link must be beyond doubt; a prediction should use everything that is known,
as far as it is. Beside the hazards of the joint fit this one has

* *entry kernels*: where views overlap, an object often appears in the next view a certain time after it *entered* this
  one, whenever it will leave it. The hazard of an appearance before the exit is the sum of one that counts from the
  entry, by zone of entry, and one that counts from the exit. Both start from what exceeds chance: started from the exit
  alone, views that end where another begins would take each other's arrivals from the views between;
* *skipped views* (`skipped`): whoever a camera misses is seen next where that camera would have led;
* a *prior* (`prior`): what leaves elsewhere in the view, and what comes back, foretells what has not been seen yet;
* *contexts* of a departure (`contexts`), and leaving the network as an outcome like the others;
* a test of whether two views overlap at all: without it what is seen elsewhere by chance counts for something;
* *sampling* at the end (`sampling`): what is believed is half of the fit and half of what its samples say;
* *doubt* (`doubt`): what of it may as well be chance, in which case nobody was seen again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints, Singles, rows_together
from camtopod.learn.association import (
    NOTHING,
    Candidates,
    Fit,
    JointFitter,
    Tables,
    not_overlapping,
    within,
)
from camtopod.learn.limits import FOLLOWED_MAX
from camtopod.learn.next_camera.contexts import Contexts, Counted, Level, multipliers
from camtopod.learn.next_camera.entry_kernels import Entering
from camtopod.learn.next_camera.prior import Prior
from camtopod.learn.next_camera.sampling import Sources, with_faint
from camtopod.learn.next_camera.skip_rate import Skipping
from camtopod.learn.next_camera.skipped_cameras import (
    Legs,
    legs_of,
    skip_hazards,
    skipped_beside,
    ways_through,
)
from camtopod.learn.next_camera.spurious import doubts
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import LEAVE_FLOOR, LagBins

FIRST_NOISE_SD = 3.0
"""A fit from nothing starts with what exceeds chance by this many standard deviations."""
FIRST_ROUNDS, FIRST_ITERATIONS = 3, 5
"""Without contexts; speed is looked at after each round."""
SCOUT_ITERATIONS = 5
"""After so many it is asked which candidates are worth following."""
NEGLIGIBLE = 1e-4
"""Candidates with a smaller responsibility after the first few iterations are left out of the
others.
"""
ITERATIONS = 8
"""With contexts, which are learned in every other one."""
SWEEPS_MIN, SWEEPS_MAX = 12, 30
"""Draws of who came from where. The first half of them does not count yet."""
DRAWN_ARRIVALS = 200_000
"""Arrivals drawn over all sweeps: with many arrivals fewer sweeps are enough."""
SAMPLES_SHARE = 0.5
"""Of what is believed in the end; the rest is what the fit said."""
SAMPLING_SEED = 2011
CONTEXTS_EVERY = 3
"""Sweeps until contexts are learned again, ..."""
SKIPS_EVERY = 10
"""... and until skipped views are looked for again."""


class Posterior(NamedTuple):
    """What prediction needs."""

    fit: Fit
    """Pairs of zones, hazards counted from the exit, responsibilities."""
    share: Floats
    """(P,) of the departures at the source, those that appear next at the target."""
    leave: Floats
    """(zones,) of the departures, those not seen again."""
    doubt: Floats
    """(P,) share of what appears at the target that may as well be chance (`doubt`)."""
    entry_source: Ints
    """(Q,) zone of entry ..."""
    entry_target: Ints
    """(Q,) ... and zone of the next appearance."""
    entry_hazard: Floats
    """(Q, bins) per second and passage still in view, counted from the entry."""
    delay: Floats
    """(P,) seconds to add to the lags (see `long_ways`)."""
    levels: list[Level]


def followed_of(
    departures: Departures,
    arrivals: Arrivals,
    candidates: Candidates,
    bins: LagBins,
    zones: int,
    until: float,
    overlapping: NDArray[np.bool_],
) -> Candidates:
    """The candidates that `fit_followed` is to look at. Who has them need not keep all, which take
    more memory. ``overlapping`` (cameras, cameras): views that are known to overlap.
    """
    scout = PosteriorFitter(departures, arrivals, candidates, bins, zones, until)
    scout.look()
    scout.skip()
    kept = scout.worth_following(overlapping)
    del scout  # it takes more memory than what is made now
    return candidates.take(kept)


def fit_followed(
    departures: Departures,
    arrivals: Arrivals,
    followed: Candidates,
    bins: LagBins,
    zones: int,
    until: float,
    evidence: Floats,
    screened: bool = False,
) -> Posterior:
    """The posterior of all that left and came up to ``until`` (seconds), from the candidates of
    `followed_of`. ``evidence``: that zones are linked, in nats (`cross_evidence`); ``screened``:
    candidates may be missing.

    Always from nothing: one that goes on from the last as events come in believes early mistakes
    ever more.
    """
    fitter = PosteriorFitter(departures, arrivals, followed, bins, zones, until)
    fitter.learn()
    fitter.sample()
    levels = fitter.levels()
    left = np.bincount(departures.zone, minlength=zones).astype(float)
    found = fitter.result()
    doubt = doubts(found.candidates.pair, found.responsibility, fitter.pairs, evidence, left)
    posterior = Posterior(
        found,
        fitter.share,
        fitter.leave,
        doubt,
        fitter.entering.source,
        fitter.entering.target,
        fitter.entry_kernels(),
        np.zeros(fitter.pairs),
        levels,
    )
    return fitter.with_skips(posterior) if screened else posterior


class PosteriorFitter(JointFitter):
    """The fit in progress."""

    def __init__(
        self,
        departures: Departures,
        arrivals: Arrivals,
        candidates: Candidates,
        bins: LagBins,
        zones: int,
        until: float,
    ) -> None:
        super().__init__(departures, arrivals, candidates, bins, zones, until)
        self._prior = Prior(candidates, self._camera, self.exposure, self._per_zone)
        self.hazard = np.zeros(0, np.float32)
        self.share, self.leave = np.zeros(self.pairs), np.ones(zones)
        self.contexts = Contexts(departures, arrivals, zones, int(self._camera.max(initial=0)) + 1)
        self._left = np.bincount(departures.zone, minlength=zones).astype(float)
        self._leaving = np.zeros(0)  # (n,) of each departure, once contexts are known
        self._through = ways_through(departures, self.contexts.entry, self._camera)
        self._multiplier: Singles | None = None  # large, so there is none before it is known
        self._skipping = Skipping(bins)
        self.entering = Entering(candidates, departures, arrivals, self.contexts.entry, bins, zones)

    def look(self) -> None:
        """A few iterations, to see which candidates are worth following."""
        self.entering.start(FIRST_NOISE_SD)
        self.hazard = self.start(FIRST_NOISE_SD)
        self._iterate(SCOUT_ITERATIONS, contexts=False)

    def worth_following(self, overlapping: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The candidates (M,) that are neither negligible nor impossible, the likeliest
        `FOLLOWED_MAX` of them.
        """
        c = self.candidates
        impossible = not_overlapping(
            c, self.departures, self.arrivals, self.responsibility, overlapping
        )
        kept = (self.responsibility > NEGLIGIBLE) & ~impossible
        rows = np.flatnonzero(kept)
        if len(rows) > FOLLOWED_MAX:
            kept[rows[np.argsort(-self.responsibility[rows], kind="stable")[FOLLOWED_MAX:]]] = False
        return kept

    def skip(self) -> None:
        """See to it that what appears after a skipped view is worth following, too."""
        self._find_skips(self.hazard)
        self._expect(self.hazard)

    def learn(self) -> None:
        """The whole fit."""
        self.entering.start(FIRST_NOISE_SD)
        self.hazard = self.start(FIRST_NOISE_SD)
        for _ in range(FIRST_ROUNDS):
            self._iterate(FIRST_ITERATIONS, contexts=False)
            self.hazard = self.use_slowness(self._handed_on())
            self._find_skips(self.hazard)
        self._iterate(ITERATIONS, contexts=True)

    def sample(self) -> None:
        """Weigh what the fit says with what is believed on average over draws of who came from
        where.
        """
        fitted, entering, skipping = self.responsibility.copy(), self.entering, self._skipping
        sources = Sources(self.candidates.arrival, len(self.arrivals.t), SAMPLING_SEED)
        believed, skipped = np.zeros((2, len(fitted)), np.float32)
        entered = np.zeros(len(entering.early))
        sweeps = min(max(DRAWN_ARRIVALS // max(len(self.arrivals.t), 1), SWEEPS_MIN), SWEEPS_MAX)
        settled = sweeps // 2
        for sweep in range(sweeps):
            self._believe(sources.draw(self.responsibility))
            hazard = self._with_faint(self._learn_hazards())
            if (sweep + 1) % SKIPS_EVERY == 0:
                self._find_skips(hazard)
            self._expect(hazard)
            del hazard  # as large as the new one
            self._drawn = None
            if sweep % CONTEXTS_EVERY == 0:
                self._learn_contexts()
            if sweep >= settled:
                believed += self.responsibility
                skipped[skipping.some] += self.responsibility[skipping.some] * skipping.part
                entered += self.responsibility[entering.early] * entering.part
        some = np.flatnonzero(skipped)
        skipping.believe(
            some, (skipped[some] / np.maximum(believed[some], NOTHING)).astype(np.float32)
        )
        entering.part = entered / np.maximum(believed[entering.early], NOTHING)
        believed *= SAMPLES_SHARE / (sweeps - settled)
        fitted *= 1.0 - SAMPLES_SHARE
        np.add(believed, fitted, out=self.responsibility)
        self.hazard = self._with_faint(self._learn_hazards())

    def levels(self) -> list[Level]:
        """What is known of contexts, and the shares beside them, in the end."""
        return self.contexts.named(self.candidates, self._count_contexts())

    def entry_kernels(self) -> Floats:
        """Entry kernels (Q, bins) by the responsibilities as they are."""
        return self.entering.kernels(self._entered())

    def _entered(self) -> Floats:
        """Responsibilities of the early candidates, as far as their lags count from the entry."""
        weight: Floats = self.responsibility[self.entering.early] * self.entering.part
        return weight

    def _with_faint(self, hazard: Singles) -> Singles:
        return with_faint(hazard, self._some_exposed, self.candidates.source, self.bins)

    def result(self) -> Fit:
        """All that leaves a view and appears in the next; ``hazard`` is that counted from the exit,
        ``counts`` nothing, as nobody asks for them. After this there is no further iteration.
        """
        self._own, self._multiplier = self._own[:0], None
        hazard = self._after_exit(self.hazard, slice(0, self.pairs))
        return self.found(Tables(hazard, np.zeros((0, self.bins.size))), self.flatness(hazard))

    def with_skips(self, posterior: Posterior) -> Posterior:
        """The posterior with what skipped views lead to beside the pairs of zones that were
        followed.
        """
        c = posterior.fit.candidates
        source, target, unit = skipped_beside(
            self._legs(self.hazard), c, self._through, self.bins, self.zones
        )
        hazard = (self._skipping.odds * unit).astype(np.float32)
        share = hazard @ self.bins.widths
        key = np.concatenate((c.source, source)).astype(np.int64) * self.zones + np.concatenate(
            (c.target, target)
        )
        order = np.argsort(key, kind="stable")
        number = np.argsort(order)  # where each pair has gone

        def mixed(known: Floats, beside: Floats) -> Floats:
            both: Floats = np.concatenate((known, beside))[order]
            return both

        fit = posterior.fit._replace(
            hazard=np.concatenate((posterior.fit.hazard, hazard))[order],
            candidates=c._replace(
                pair=number[c.pair].astype(np.int32),
                source=(key[order] // self.zones).astype(np.int32),
                target=(key[order] % self.zones).astype(np.int32),
            ),
        )
        gone = posterior.leave - np.bincount(source, share, minlength=self.zones)
        return posterior._replace(
            fit=fit,
            share=mixed(posterior.share, share),
            doubt=mixed(posterior.doubt, np.zeros(len(source))),
            delay=np.zeros(len(order)),
            leave=np.maximum(gone, LEAVE_FLOOR),
        )

    def _to_count(self) -> Singles:
        return np.concatenate([np.zeros(0, np.float32), *map(self._at_exit, self._parts)])

    def _iterate(self, iterations: int, contexts: bool) -> None:
        for iteration in range(iterations):
            self._expect(self.hazard)
            self.hazard = self._learn_hazards()
            if contexts and iteration % 2 == 0:
                self._learn_contexts()

    def _learn_hazards(self) -> Singles:
        """M step: hazards (P, bins) counted from the exit without those of skipped views; and all
        other tables.
        """
        self._handed_on()  # they were as large as the new ones
        self.entering.learn(self._entered())
        self._skipping.learn(self.responsibility, self._left[self.candidates.source])
        self._look_outside()
        return self._hazards(self._count(map(self._at_exit, self._telling)))

    def _handed_on(self) -> Singles:
        """The hazards, which the fitter does not have any more."""
        hazard, self.hazard = self.hazard, np.zeros(0, np.float32)
        return hazard

    def _at_exit(self, part: slice | Indices) -> Singles:
        """Responsibilities of a part as far as lags count from the exit and no view is skipped."""
        shares = self.responsibility[part].copy()
        other = np.zeros(len(shares), np.float32)
        for some, elsewhere in (
            (self._skipping.some, self._skipping.part),
            (self.entering.early, self.entering.part),
        ):
            if isinstance(part, slice):
                here = within(some, part)
                other[some[here] - part.start] += elsewhere[here]
            else:
                drawn = np.flatnonzero(self.responsibility[some])
                other[np.searchsorted(part, some[drawn])] += elsewhere[drawn]
        shares *= np.maximum(1.0 - other, 0.0)
        return shares

    def _hazards(self, counts: Floats) -> Singles:
        expected = self._prior.expected(counts)
        smoothed = self._smoothed(counts)
        del counts  # they are larger than the hazards
        hazard = np.empty_like(smoothed)
        for rows in rows_together(self.pairs):
            beforehand = expected.of(rows, lambda back: smoothed[back] / self._exposed(back))
            per_second = (self._exposed(rows) + expected.departures) * self.bins.widths
            np.divide(smoothed[rows] + beforehand, per_second, out=hazard[rows])
        return hazard

    def _find_skips(self, hazard: Singles) -> None:
        """Hazards of skipped views, by the links and passages as they are known now."""
        pair, unit = skip_hazards(
            self._legs(hazard), self.candidates, self._through, self.bins, self.zones
        )
        self._skipping.use(pair, unit, self.candidates, self._cell, self._parts)

    def _legs(self, hazard: Singles) -> Legs:
        """What appears next, as legs of ways over a skipped view."""
        share = np.concatenate(
            [self._appears(hazard[rows], rows).sum(axis=1) for rows in rows_together(self.pairs)]
        )
        return legs_of(
            share, lambda some: self._appears(hazard[some], some), self.candidates, self.bins
        )

    def _weights(self, hazard: Singles, part: slice) -> Singles:
        """Hazard of each candidate of a part that the others make."""
        weight = super()._weights(hazard, part)
        entering = self.entering
        here = within(entering.early, part)
        early = entering.early[here]
        others = np.maximum(1.0 - self.responsibility.take(early) * entering.own[here], 0.0)
        entered = entering.hazard[here] * others
        if self._agreement is not None:
            entered *= self._agreement.take(early)
        weight[early - part.start] += entered
        skipping = self._skipping
        there = within(skipping.some, part)
        some = skipping.some[there].astype(np.intp)
        skipped = skipping.hazard(there)
        if self._agreement is not None:
            skipped *= self._agreement.take(some)
        weight[some - part.start] += skipped
        skipping.part[there] = skipped / np.maximum(weight.take(some - part.start), NOTHING)
        entering.part[here] = entered / np.maximum(weight.take(early - part.start), NOTHING)
        if self._multiplier is not None:
            weight *= self._multiplier[part]
        return weight

    def _after_exit(self, hazard: Singles, rows: slice) -> Singles:
        return self._skipping.added(hazard[rows], rows)

    def _leave(self, hazard: Singles) -> Floats:
        return self._leaving if len(self._leaving) else super()._leave(hazard)

    def _learn_contexts(self) -> None:
        """What contexts make of the shares."""
        c, counted = self.candidates, self._count_contexts()
        multiplier = self.contexts.judged(c, self.responsibility, self.share, counted)
        for part in self._parts:
            multiplier[part] = multipliers(
                self.share.take(c.pair[part]), multiplier[part].astype(float)
            )
        self._multiplier = multiplier

    def _count_contexts(self) -> list[Counted]:
        """Shares and leaving by zone, then by context."""
        c, zone = self.candidates, self.departures.zone
        below = np.maximum(self._left, 1e-9)
        self.share = self._added(c.pair, self.pairs) / below[c.source]
        gone = 1.0 - np.minimum(self._of_all(self._added(c.departure, len(zone))), 1.0)
        self.leave = np.maximum(np.bincount(zone, gone, minlength=self.zones) / below, LEAVE_FLOOR)
        counted, leaving = self.contexts.count(c, self.responsibility, gone, self.leave[zone])
        self._leaving = np.maximum(leaving, LEAVE_FLOOR)
        return counted
