"""Evidence that was not fitted to itself: each part of the time judged by what other parts taught.

A flexible fit finds something in any data; how well it explains the data it was fitted to says
little. So the window is cut into stretches of time dealt out to eight parts. The links are fitted
on the first part alone, from nothing, and asked how much better they predict the arrivals of the
second with a pair of zones than without; then fitted on the first two and asked about the third,
and so on. Where zones have nothing to do with each other, each likelihood ratio is 1 at most in the
mean, whatever shape the fit could have taken, and so is their product, as each bets on what the
bets before it have not seen (a test martingale; Shafer and others, Statistical Science 26(1), 2011;
Wasserman, Ramdas and Balakrishnan 2020). The same is done from the last part backwards, and with
bets that are partly spread over all lags (`EVEN_SHARES`). The mean of the products is an e-value:
it exceeds ``exp(x)`` with a probability of at most ``exp(-x)``, and false discovery rates may be
made of such without knowing how they depend on each other (Wang and Ramdas 2022). The bound is
approximate, as the likelihood approximates the competition for departures and the rates of the null
model; on simulated networks without links there are far fewer false links than it allows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Longs, Singles
from camtopod.learn.association import Candidates, Fit, JointFitter, adjust
from camtopod.learn.traffic import Arrivals, Chance, Departures
from camtopod.topology import LagBins

PARTS = 8
BETS = ((1, 2), (2, 3), (3, 5), (5, 8))
"""(fitted on the parts before this one, asked about these up to that one)."""
STRETCHES = 32
"""The window is cut into about this many stretches, dealt out to the parts in turn ..."""
STRETCH_SECONDS_MAX = 3600.0
STRETCH_LAGS_MIN = 4.0
"""... but none shorter than this many times the longest transit, unless the window is too short for
that.
"""
BET_SPARSITY = 0.5
"""Transitions that the sparse prior takes off each pair before the bet: fewer than in the fit, as a
part has few.
"""
EVEN_SHARES = (0.0, 0.3)
"""Shares of a hazard that are spread evenly over all lags before a bet: a bet on a sharp hazard
alone loses much on each arrival outside its peak. The mean of the products over these shares is an
e-value, too.
"""
SWEEPS = 3
ROUNDS = 1
"""Rounds of each fit before the last."""
RESPONSIBILITY_MAX = 1.0 - 1e-7
FLAT_MAX = 1e6


def cross_evidence(
    departures: Departures,
    arrivals: Arrivals,
    fit: Fit,
    bins: LagBins,
    zones: int,
    first: float,
    until: float,
) -> Floats:
    """Log likelihood ratio (P,) in nats of each pair of zones of ``fit`` over the window from
    ``first`` to ``until``.

    Against two nulls, the stronger counts: the zones have nothing to do with each other; or
    arrivals at one follow departures from the other at no particular lag, as when both follow a
    rhythm.
    """
    parts = Parts(departures, arrivals, fit, bins, zones, first, until)
    numbers = np.arange(PARTS)
    products = [*_products(parts, numbers), *_products(parts, numbers[::-1])]
    mean: Floats = np.logaddexp.reduce(products) - np.log(len(products))
    return mean


def _products(parts: Parts, order: Longs) -> list[Floats]:
    """Evidence (P,) in nats by each of the `EVEN_SHARES`, the parts taken in this order."""
    evidence = np.zeros((len(EVEN_SHARES), 2, len(parts.fit.candidates.source)))
    for known, upto in BETS:
        rest, judged = parts.take(order[:known]), parts.take(order[known:upto])
        hazard = _fitted(rest)
        for number, share in enumerate(EVEN_SHARES):
            evidence[number] += _evidence(judged, judged.hedged(hazard, share), rest.outside)
    return list(evidence.min(axis=1))


class Parts:
    """The window in parts: which has which departures and arrivals, and what could have been seen
    in it.
    """

    def __init__(
        self,
        departures: Departures,
        arrivals: Arrivals,
        fit: Fit,
        bins: LagBins,
        zones: int,
        first: float,
        until: float,
    ) -> None:
        self.departures, self.arrivals, self.fit = departures, arrivals, fit
        self.bins, self.zones, self.first, self.until = bins, zones, first, until
        span = max(until - first, 1.0)
        self.stretch = min(
            max(span / STRETCHES, STRETCH_LAGS_MIN * bins.lag_max),
            STRETCH_SECONDS_MAX,
            span / PARTS,
        )
        self._left, self._came = self._of(departures.t), self._of(arrivals.t)
        self._exposure = self._exposures()
        self._adjusted = adjust(fit.candidates, departures, arrivals, fit.persistence, bins)

    def take(self, numbers: Longs) -> PartFitter:
        """A fit of what came in these parts, pairs numbered as in the fit."""
        left, came = np.isin(self._left, numbers), np.isin(self._came, numbers)
        c = self.fit.candidates
        kept, arrival = np.flatnonzero(came[c.arrival]), (np.cumsum(came) - 1).astype(np.int32)
        candidates = Candidates(
            c.departure[kept],
            arrival[c.arrival[kept]],
            c.pair[kept],
            c.lag[kept],
            c.source,
            c.target,
        )
        fitter = PartFitter(
            self.departures,
            self.arrivals.take(came),
            candidates,
            self.bins,
            self.zones,
            self.until,
            self._exposure[numbers].sum(axis=0),
            self._adjusted.take(kept),
        )
        fitter.near = left if left.any() else ~left
        return fitter

    def _of(self, t: Floats) -> Longs:
        """Part of each time."""
        part: Longs = np.floor((t - self.first) / self.stretch).astype(np.int64) % PARTS
        return part

    def _exposures(self) -> Floats:
        """Departures of each zone whose lag bin lies in the part and could have been seen: (PARTS,
        zones, bins).

        Without this, a long lag would be seen less often than a short one, which often ends in the
        stretch it began in, and short lags would look like links.
        """
        d, bins = self.departures, self.bins
        result = np.zeros((PARTS, self.zones, bins.size))
        for k, centre in enumerate(bins.centres):
            if bins.edges[k + 1] <= 0:
                seen = np.clip((bins.edges[k + 1] + d.t - d.since) / bins.widths[k], 0.0, 1.0)
            else:
                seen = (self.until - d.t >= bins.edges[k + 1]).astype(float)
            cell = self._of(d.t + centre) * self.zones + d.zone
            result[:, :, k] = np.bincount(cell, seen, minlength=PARTS * self.zones).reshape(
                PARTS, self.zones
            )
        return result


class PartFitter(JointFitter):
    """A fit of the arrivals of some parts to all departures."""

    near: NDArray[np.bool_]
    """(n,) departures in the same parts, for the rates of chance; all if there are none."""

    def _chance(self) -> Chance:
        left, came = self.departures, self.arrivals
        return Chance(left.t[self.near], left.zone[self.near], came.t, came.zone, self.zones)


def _fitted(fitter: JointFitter) -> Singles:
    """Hazards (P, bins) from one part of the time alone and from nothing; the sparse prior comes in
    at the end.
    """
    fitter.sparsity = 0.0
    hazard = fitter.start()
    for _ in range(ROUNDS):
        hazard = fitter.run(hazard).hazard
    fitter.sparsity = BET_SPARSITY
    return fitter.run(hazard).hazard


def _evidence(fitter: JointFitter, hazard: Singles, outside: Floats) -> tuple[Floats, Floats]:
    """Log likelihood ratios (P,) of each pair against no link and against a link without a transit
    time.
    """
    fitter.outside = outside
    share = np.minimum(fitter.expect_afresh(hazard, SWEEPS), RESPONSIBILITY_MAX)
    c = fitter.candidates
    expected: Floats = (hazard * fitter.exposure[c.source] * fitter.bins.widths).sum(axis=1)
    unrelated: Floats = np.bincount(c.pair, -np.log1p(-share), minlength=fitter.pairs) - expected
    flat = np.minimum(fitter.flatness(hazard), FLAT_MAX)
    untimed: Floats = np.bincount(
        c.pair, -np.log1p(share * (flat - 1.0)), minlength=fitter.pairs
    ).astype(float)
    return unrelated, untimed
